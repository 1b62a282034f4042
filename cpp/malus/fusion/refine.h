#pragma once

#include <array>
#include <complex>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/fields.h"
#include "malus/core/image.h"
#include "malus/fusion/fused_surface.h"
#include "malus/fusion/reflection_model.h"
#include "malus/fusion/surroundings.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/reflection.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// What the station file says about the object's surface.
struct RefineInput {
  std::optional<double> refractive_index = 1.5;  ///< none = estimated from the data
  ReflectionChoice reflection = ReflectionChoice::automatic;
  Mask labels;  ///< with ReflectionChoice::labels: 1 = diffuse, 2 = specular, 0 = not known; else empty
};

struct RefineOptions {
  int iterations = 2;
  int surroundings_iterations = 10;
  int fine_iterations = 2;
  int more_iterations = 3;
  int steps = 2;
  double coarsest_px = 100;
  int tile_px = 384;
  int margin_px = 32;
  double strip_megapixels = 6;
  double robust_scale = 2.5;
  double graduation = 4;
  double relative_error = 0.002;
  double slope_error = 0.03;
  double prior_weight = 5;
  double good_prior_weight = 12;
  double prior_robust_gsd = 2;
  double albedo_weight = 10;
  double albedo_contrast = 0.04;
  double smoothness = 3;
  double search_sharpening = 2.5;
  bool search = true;
  bool environment = true;
  bool lobe = true;
  bool regional_weights = true;
  bool surroundings = true;
  bool correct_index = true;
  bool evidence = true;
  double explained_least = 0.35;
  double explained_enough = 0.55;
  double anchor = 8;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("iterations", self.iterations, Range{1, 50}, "rounds of: fit reflection, weigh residuals, solve");
    visit("surroundings_iterations", self.surroundings_iterations, Range{1, 50},
          "such rounds, of one step each, with a map of the surroundings: map and surface find each other slowly");
    visit("fine_iterations", self.fine_iterations, Range{1, 50}, "such rounds after those at half the resolution");
    visit("coarsest_px", self.coarsest_px, Range{16, 1e9},
          "where a search is worth it, objects are refined at half the resolution first, down to this width and "
          "height, in px");
    visit("more_iterations", self.more_iterations, Range{0, 50},
          "most such rounds at the end while the surface moves by 0.5 GSD");
    visit("steps", self.steps, Range{1, 50}, "Gauss-Newton steps of each solve after the first two, which take one");
    visit("tile_px", self.tile_px, Range{64, 4096}, "largest side of a tile's core");
    visit("margin_px", self.margin_px, Range{16, 512}, "overlap of a tile with its neighbors");
    visit("strip_megapixels", self.strip_megapixels, Range{0.001, 1e6},
          "size of the strips of whole rows of tiles that are worked on one after the other; memory grows with it");
    visit("robust_scale", self.robust_scale, Range{0.1, 100},
          "Stokes residual, in standard deviations, that counts half");
    visit("graduation", self.graduation, Range{1, 100},
          "factor on robust_scale of specular regions in the first round, halved every round");
    visit("relative_error", self.relative_error, Range{0, 0.1}, "error of the reflection model as a share of s0");
    visit("slope_error", self.slope_error, Range{0, 1}, "error of the reflection model as a slope");
    visit("prior_weight", self.prior_weight, not_negative, "least weight of a full prior block, in 1 / GSD …");
    visit("good_prior_weight", self.good_prior_weight, not_negative,
          "… and the largest one; between them by the prior's sigma");
    visit("prior_robust_gsd", self.prior_robust_gsd, Range{0.01, 1000}, "distance from the prior that counts half");
    visit("albedo_weight", self.albedo_weight, not_negative,
          "weight of the albedo gradient in diffuse regions, up to 2.5 times that where albedo varies little");
    visit("albedo_contrast", self.albedo_contrast, Range{1e-4, 10}, "log-albedo step between pixels that counts half");
    visit(
        "smoothness", self.smoothness, not_negative,
        "weight of the second differences of the change to the prior, where all that is wrong with the polarization is "
        "noise; less by the share of other errors");
    visit("search_sharpening", self.search_sharpening, Range{-10, 10},
          "factor on the prior's detail that the search for a better minimum starts with");
    visit("search", self.search, any_value,
          "with specular regions: solve from a second start and keep the better regions of both");
    visit("environment", self.environment, any_value, "fit what diffuse regions mirror of the surroundings");
    visit("lobe", self.lobe, any_value, "fit a highlight of a small source in diffuse regions");
    visit("regional_weights", self.regional_weights, any_value, "down-weigh regions that fit badly");
    visit("surroundings", self.surroundings, any_value,
          "where that explains more of the polarization, take the object as matt and mirroring its surroundings");
    visit("correct_index", self.correct_index, any_value,
          "replace a refractive index that the polarization clearly contradicts");
    visit("evidence", self.evidence, any_value,
          "keep the prior's surface where the reflection model does not explain the polarization");
    visit("explained_least", self.explained_least, Range{-1, 1},
          "share of the polarization, explained at the prior's slopes, up to which the prior's surface is kept …; with "
          "a map of the surroundings other limits hold");
    visit("explained_enough", self.explained_enough, Range{-1, 1}, "… and from which on the refined one is");
    visit("anchor", self.anchor, not_negative,
          "the prior's low frequencies are kept beyond this times the square root of its points' noise (GSD) times "
          "their distance (px), in px; 0 = not");
  }
};

/// One round of the refinement.
struct RefineIteration {
  int binning = 1;                         ///< 2 = at half the resolution, and so on
  bool search = false;                     ///< on the way to a second solution, not to the result
  double cost_before = 0, cost_after = 0;  ///< of the solve, summed over tiles
  double stokes_cost = 0;                  ///< mean of ln(1 + r² / 4) over usable pixels, before the solve
  double median_residual = 0;              ///< of the Stokes vectors, in standard deviations, before the solve
  double change_gsd = 0;                   ///< RMS change of depth
  int rejected_steps = 0;
  double seconds = 0;
};

/// What the refinement found out beside the surface.
struct RefineReport {
  std::vector<RefineIteration> iterations;
  ReflectionModel reflection;  ///< with eta
  Surroundings surroundings;   ///< without radiance if they are not the model
  /// n + i k of the metal that the model with surroundings takes the object for; 0 = not for a metal.
  std::complex<double> metal_index = 0;
  double eta_sigma = 0;              ///< 0 = the index is given, NaN = neither given nor told by the data
  std::optional<double> stated_eta;  ///< only where another index explains the polarization clearly better
  std::array<double, EnvironmentProfile::node_count> environment_sigma{};
  double lobe_strength_sigma = 0, lobe_roughness_sigma = 0, light_sigma_rad = 0;
  double mirror_body_sigma = 0, mirror_environment_sigma = 0;
  bool metal = false;              ///< mirrors like a metal, for which the formulas do not hold
  double specular_share = 0;       ///< of the object's pixels
  Image<std::uint8_t> label;       ///< 0 = outside, 1 = diffuse, 2 = specular
  Image<std::uint8_t> confidence;  ///< weight of the polarization of each pixel, 0 … 255
  Image<float> mirrored;           ///< unpolarized intensity of the mirrored light, unit of the images; NaN = not known
  /// Share of the refined surface in the result, 0 (prior) … 255. Empty, and the shares NaN, without `evidence`.
  Image<std::uint8_t> trust;
  double trusted_share = std::numeric_limits<double>::quiet_NaN();  ///< its mean over usable pixels, 0 … 1
  /// Of the polarization at the prior's slopes, mean over the object, −1 … 1: all of it (with surroundings that beyond
  /// a plane's), and that beyond a plane's.
  double explained_share = std::numeric_limits<double>::quiet_NaN();
  double explained_beyond_plane = std::numeric_limits<double>::quiet_NaN();
  double stokes_cost = 0;                       ///< mean of ln(1 + r² / 4) over usable pixels, of the result
  double median_residual = 0;                   ///< of the result's Stokes vectors, in standard deviations
  int regions_compared = 0, regions_taken = 0;  ///< of the search for a better minimum
  int tiles = 0;
  double seconds = 0;
  double linear_solver_share = 0;  ///< of the time spent in Ceres
};

struct RefineResult {
  FusedSurface surface;
  RefineReport report;
};

/// Refines the prior with the polarization: nonlinear least squares on log-depth with Ceres, docs/method.md section 4.
///
/// Unknown: x = f (ln z − mean) at the corners of every pixel with a finite prior and a known Stokes vector. Residuals:
/// (s1, s2) against the forward model, neighboring albedos in diffuse regions, block means of the prior, small second
/// differences. Reflection parameters, light and robust weights are fitted between
/// solves. Throws an input error for sizes and options that do not fit, a data error when nothing is left to refine.
/// The reflection model is either of two, whichever explains more at the prior's slopes: regions that are diffuse or
/// specular, with an environment by zenith, or an object that is matt all over and mirrors its surroundings
/// (surroundings.h). Where the model does not explain the polarization at the prior's slopes, the prior's surface stays
/// (see surface_evidence_internal.h), which surface.confidence and report.trust tell. What the data cannot support
/// otherwise is in surface.confidence and warnings; surface.status is the solver's ("converged", "not converged").
RefineResult refine(const PolarizationState& state, const DepthPrior& prior, const RefineInput& input,
                    const RefineOptions& options, const Context& context);

}  // namespace malus
