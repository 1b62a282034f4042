#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"
#include "malus/options/fusion_options.h"

namespace malus {

/// A pixel as a sample for the fits of the shared reflection parameters, which take its slopes as known.
struct ReflectionSample {
  double p = 0, q = 0;
  double s0 = 0, s1 = 0, s2 = 0;
  double sigma = 1;  ///< of s1 and s2: noise and a small relative model error
  RayFrame frame;
  bool other_finish = false;  ///< has the other of two finishes

  double tan2() const { return p * p + q * q; }
};

/// A pixel at these slopes.
ReflectionSample sample_of(const PixelData& pixel, const Slopes& slopes, const RayFrame& frame);

/// Usable pixels of one kind of reflection at the current slopes, thinned evenly to at most about `largest_count`.
std::vector<ReflectionSample> collect_samples(const RefinementImage& image, Reflection kind, std::size_t largest_count);

/// Light of a diffuse surface.
struct Shading {
  Eigen::Vector3d light = -Eigen::Vector3d::UnitZ();       ///< unit, towards the light: s0 ≈ n · c
  ShadingHarmonics harmonics = ShadingHarmonics::Unit(0);  ///< s0 ≈ c · basis(n)
};

/// Robust fits of s0 against the normals.
Shading fit_shading(const std::vector<ReflectionSample>& samples);

/// Robust fit of the body light against the normals, to the second order, with relative errors. The model must have a
/// map of the surroundings.
ShadingHarmonics fit_body_shading(const std::vector<ReflectionSample>& samples, const ReflectionModel& model);

/// Fit of the diffuse model to the Stokes vectors at known slopes; costs are means of ln(1 + r² / 4).
struct DiffuseFit {
  EnvironmentProfile environment;
  HighlightLobe lobe;
  double cost = 0;
  double cost_without_lobe = 0;
  std::array<double, EnvironmentProfile::node_count> environment_sigma{};
  double strength_sigma = 0, roughness_sigma = 0, light_sigma_rad = 0;
};

/// Fits the environment profile and, where it lowers the robust cost, a highlight lobe, each only if the options
/// include it. `start` is the previous fit's lobe; if its strength is 0, the fit starts from its light direction and
/// several roughnesses.
DiffuseFit fit_diffuse(const std::vector<ReflectionSample>& samples, double eta, const RefineOptions& options,
                       const HighlightLobe& start, const Context& context);

struct SpecularFit {
  MirrorReflection mirror;
  double cost = 0;
  double body_sigma = 0, environment_sigma = 0;
};

/// Fits the body light and the usual radiance of the surroundings.
SpecularFit fit_specular(const std::vector<ReflectionSample>& samples, double eta);

/// Error of a pixel's polarization due to the usual error of the slopes, which are taken as known. Computed with the
/// usual refractive index, so that costs of several indices can be compared.
double error_of_slopes(const ReflectionSample& sample, Reflection kind);

struct RefractiveIndexFit {
  double eta = 1.5;
  double sigma = 0;          ///< from the scatter between parts of the image, whose slope errors differ
  bool determined = false;   ///< inside the range of indices, and known to about a fifth of that range
  bool contradicts = false;  ///< determined, and clearly different from the supposed index
};

/// Refractive index from 1.3 to 2.0 that explains the pixels of the image best at their slopes; all other parameters
/// are fitted for each tried index. Call it at the prior's slopes: refined slopes would confirm the index that they
/// were found with.
RefractiveIndexFit fit_refractive_index(const RefinementImage& image, double supposed, const RefineOptions& options,
                                        const Context& context);

}  // namespace malus
