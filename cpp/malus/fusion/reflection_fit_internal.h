#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// A pixel as the fits of the shared reflection parameters see it: slopes are taken as known.
struct ReflectionSample {
  double p = 0, q = 0;
  double s0 = 0, s1 = 0, s2 = 0;
  double sigma = 1;  ///< of s1 and s2: noise and a small relative model error
  RayFrame frame;
  bool other_finish = false;  ///< as rough as the other of two finishes

  double tan2() const { return p * p + q * q; }
};

/// A pixel at these slopes.
ReflectionSample sample_of(const PixelData& pixel, const Eigen::Vector2d& slopes, const RayFrame& frame);

/// Usable pixels of one kind at the current slopes, thinned evenly to at most about `largest_count`.
std::vector<ReflectionSample> collect_samples(const RefinementImage& image, Reflection kind, std::size_t largest_count);

/// Light of a diffuse surface.
struct Shading {
  Eigen::Vector3d light = -Eigen::Vector3d::UnitZ();       ///< unit, towards the light: s0 ≈ n · c
  ShadingHarmonics harmonics = ShadingHarmonics::Unit(0);  ///< s0 ≈ c · basis(n)
};

/// Robust fits of s0 against the normals.
Shading fit_shading(const std::vector<ReflectionSample>& samples);

/// Of the body's light against the normals, to the second order; the errors are relative. The model has a map.
ShadingHarmonics fit_body_shading(const std::vector<ReflectionSample>& samples, const ReflectionModel& model);

/// How well a reflection model explains the Stokes vectors at known slopes: mean of ln(1 + r² / 4).
struct DiffuseFit {
  EnvironmentProfile environment;
  HighlightLobe lobe;
  double cost = 0;
  double cost_without_lobe = 0;
  std::array<double, EnvironmentProfile::node_count> environment_sigma{};
  double strength_sigma = 0, roughness_sigma = 0, light_sigma_rad = 0;
};

/// What a diffuse body may mirror.
struct MirroredTerms {
  bool environment = true, lobe = true;
};

/// Fits the environment profile and, where it lowers the robust cost, a highlight lobe, as far as they are wanted.
/// `start` is the previous fit's lobe; a lobe without strength starts from its light direction and several roughnesses.
DiffuseFit fit_diffuse(const std::vector<ReflectionSample>& samples, double eta, MirroredTerms terms,
                       const HighlightLobe& start, const Context& context);

struct SpecularFit {
  MirrorReflection mirror;
  double cost = 0;
  double body_sigma = 0, environment_sigma = 0;
};

/// Fits body light and the surroundings' usual radiance.
SpecularFit fit_specular(const std::vector<ReflectionSample>& samples, double eta);

/// What slopes that are taken as known and are wrong by a usual error change in the polarization of a pixel. By the
/// formulas of the usual index, so that costs of several indices can be compared.
double error_of_slopes(const ReflectionSample& sample, Reflection kind);

struct RefractiveIndexFit {
  double eta = 1.5;
  double sigma = 0;          ///< from how much parts of the image differ, whose slopes are wrong in different ways
  bool determined = false;   ///< within the range, and known to better than a fifth of it
  bool contradicts = false;  ///< determined, and clearly not the supposed one
};

/// Refractive index from 1.3 to 2.0 with which the pixels of the image are explained best at their slopes, every other
/// parameter fitted to each try. At the prior's slopes: refined ones would confirm whatever index they were found with.
RefractiveIndexFit fit_refractive_index(const RefinementImage& image, double supposed, MirroredTerms terms,
                                        const Context& context);

}  // namespace malus
