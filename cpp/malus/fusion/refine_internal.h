#pragma once

#include <array>
#include <complex>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/field_list.h"
#include "malus/core/image.h"
#include "malus/core/reflection_choice.h"
#include "malus/fusion/fused_surface.h"
#include "malus/fusion/reflection_model_internal.h"
#include "malus/fusion/surroundings_internal.h"
#include "malus/options/fusion_options.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/reflection.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// What the station file states about the object's surface.
struct RefineInput {
  std::optional<double> refractive_index = 1.5;  ///< none = estimated from the data
  ReflectionChoice reflection = ReflectionChoice::automatic;
  Mask labels;                 ///< with ReflectionChoice::labels: 1 = diffuse, 2 = specular, 0 = not known; else empty
  std::string metal = "auto";  ///< as in the station file, see core/metal_internal.h
};

/// How well a stated metal explains the data at the prior's slopes.
struct StatedMetalFit {
  double intensity_error = 0;         ///< median of |s0 − m0| / s0
  double stokes_cost = 0;             ///< of (s1, s2): mean of ln(1 + r² / 4)
  double dielectric_stokes_cost = 0;  ///< the same for a dielectric with a map of the surroundings

  MALUS_FIELDS(intensity_error, stokes_cost, dielectric_stokes_cost)
};

/// One round of the refinement.
struct RefineIteration {
  int binning = 1;      ///< 2 = at half the resolution, and so on
  bool search = false;  ///< part of the search for a second solution, not of the course to the result
  double cost_before = 0, cost_after = 0;      ///< of the solve, summed over tiles
  double stokes_cost = 0;                      ///< mean of ln(1 + r² / 4) over usable pixels, before the solve
  double median_residual = 0;                  ///< of the Stokes vectors, in standard deviations, before the solve
  double change_gsd = 0;                       ///< RMS change of depth, in the GSD of this resolution
  int accepted_steps = 0, rejected_steps = 0;  ///< of the solver, summed over tiles
  int failed_tiles = 0;  ///< whose equations could not be solved: their surface is that of the round before
  int tiles = 0;         ///< that hold a part of the object, out of RefineReport::tiles

  MALUS_FIELDS(binning, cost_before, cost_after, stokes_cost, median_residual, change_gsd, rejected_steps, failed_tiles)
};

/// What the refinement found beside the surface.
struct RefineReport {
  std::vector<RefineIteration> iterations;
  ReflectionModel reflection;  ///< with eta
  Surroundings surroundings;   ///< without radiance if the model has no map of the surroundings
  /// Share of the usable pixels that a map of the surroundings excludes because they mirror the object itself, 0 … 1.
  double self_mirroring_share = 0;
  double other_finish_share = 0;  ///< of the usable pixels; 0 = all have one finish
  /// n + i k of the metal assumed by the model with surroundings; 0 = no metal.
  std::complex<double> metal_index = 0;
  std::optional<StatedMetalFit> stated_metal;  ///< only of a metal that the station file states
  double eta_sigma = 0;              ///< 0 = the index is given, NaN = neither given nor determined by the data
  std::optional<double> stated_eta;  ///< only where another index explains the polarization clearly better
  std::array<double, EnvironmentProfile::node_count> environment_sigma{};
  double lobe_strength_sigma = 0, lobe_roughness_sigma = 0, light_sigma_rad = 0;
  double mirror_body_sigma = 0, mirror_environment_sigma = 0;
  bool metal = false;              ///< reflects like a metal, for which the dielectric formulas do not hold
  bool metal_excluded = false;     ///< optics.metal = "none"
  double specular_share = 0;       ///< of the object's pixels
  Image<std::uint8_t> label;       ///< 0 = outside, 1 = diffuse, 2 = specular
  Image<std::uint8_t> confidence;  ///< weight of the polarization of each pixel, 0 … 255
  Image<float> mirrored;           ///< unpolarized intensity of the mirrored light, unit of the images; NaN = not known
  /// Share of the refined surface in the result, 0 (prior) … 255. Empty, and the shares NaN, without `evidence`.
  Image<std::uint8_t> trust;
  double trusted_share = std::numeric_limits<double>::quiet_NaN();  ///< mean of `trust` over usable pixels, 0 … 1
  /// Explained shares of the polarization at the prior's slopes, means over the object, −1 … 1: of all polarization
  /// (with a map of the surroundings, of what a plane does not explain), and always of what a plane does not explain.
  double explained_share = std::numeric_limits<double>::quiet_NaN();
  double explained_beyond_plane = std::numeric_limits<double>::quiet_NaN();
  /// How well the object's shape separates relief from uneven light (see trust_of_shape), 0 … 1.
  double shape_share = 1;
  /// Share of the surface's movement from the prior that is gain (GainByScale), mean over the object, 0 … 1.
  double gain_share = std::numeric_limits<double>::quiet_NaN();
  /// Median residual of the Stokes vectors at the result, in standard deviations, over the usable pixels that are
  /// refined by half or more; 0 if there are none.
  double median_residual = 0;
  int regions_compared = 0, regions_taken = 0;  ///< by the search for a better minimum
  int tiles = 0;
  double linear_solver_share = 0;  ///< of the time spent in Ceres

  // The model and the maps are not in the list of fields.
  MALUS_FIELDS(specular_share, explained_share, explained_beyond_plane, trusted_share, gain_share, shape_share,
               regions_compared, regions_taken, tiles, iterations)
};

struct RefineResult {
  FusedSurface surface;
  RefineReport report;
};

/// Refines the prior with the polarization: nonlinear least squares on log-depth with Ceres, docs/method.md section 4.
///
/// Unknown: x = f (ln z − mean) at the corners of every pixel with a finite prior and a known Stokes vector. Residuals:
/// (s1, s2) against the forward model, neighboring albedos in diffuse regions, block means of the prior, small second
/// differences. Reflection parameters, light and robust weights are fitted between solves. Throws an input error for
/// inconsistent sizes, options out of range or a metal that contradicts the stated reflection, a data error if no pixel
/// is left to refine. There are two reflection models, and the one that explains more at the prior's slopes is taken:
/// regions that are diffuse or specular, with an environment by zenith; or an object that is matte all over and mirrors
/// its surroundings (surroundings_internal.h). A stated metal is not tried but taken, with the second model.
/// Where the model does not explain the polarization at the prior's slopes, the prior's surface stays (see
/// surface_evidence_internal.h); surface.confidence and report.trust show where. Other limits of the data are in
/// surface.confidence and surface.warnings; surface.status is the solver's ("converged", "not converged").
RefineResult refine(const PolarizationState& state, const DepthPrior& prior, const RefineInput& input,
                    const RefineOptions& options, const Context& context);

}  // namespace malus
