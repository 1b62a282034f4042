#include <algorithm>
#include <array>
#include <cmath>

#include "malus/core/median_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/fusion/fresnel_factors_internal.h"
#include "malus/fusion/reweighing_internal.h"
#include "malus/fusion/specular_fit_internal.h"

namespace malus {
namespace {

/// Robust relative spread of s0 minus the mirror image of the usual surroundings, where the surface faces the camera
/// enough to mirror them.
double body_spread(const std::vector<ReflectionSample>& samples, const MirrorReflection& mirror, double eta) {
  constexpr double frontal_tan2 = 1.0 / 3;  // zenith below 30°
  std::vector<double> rest;
  for (const ReflectionSample& s : samples) {
    if (s.slopes.tan2() < frontal_tan2)
      rest.push_back(s.s0 - mirror.environment * fresnel_factors(s.slopes.tan2(), eta).reflectance);
  }
  return robust_spread_about(median(rest), rest) / mirror.body;
}

}  // namespace

SpecularFit fit_specular(const std::vector<ReflectionSample>& samples, double eta) {
  SpecularFit fit;
  if (samples.empty()) return fit;
  const std::size_t count = samples.size();
  std::vector<Eigen::Vector2d> offset(count), column(count);
  for (std::size_t i = 0; i < count; ++i) {
    const ReflectionSample& s = samples[i];
    const FresnelFactors f = fresnel_factors(s.slopes.tan2(), eta);
    const double ratio = f.specular / f.reflectance;
    const Eigen::Vector2d direction = s.slopes.direction() / s.sigma;
    offset[i] = Eigen::Vector2d(s.s1, s.s2) / s.sigma + s.s0 * ratio * direction;
    column[i] = (f.diffuse + ratio) * direction;
  }
  std::vector<double> weights(count, 1.0), squares(count);
  double body = 0, scale = 1, normal = 0;
  for (int round = 0; round < irls_rounds; ++round) {
    double rhs = 0;
    normal = 0;
    for (std::size_t i = 0; i < count; ++i) {
      normal += weights[i] * column[i].squaredNorm();
      rhs += weights[i] * column[i].dot(offset[i]);
    }
    body = rhs / std::max(normal, 1e-300);
    for (std::size_t i = 0; i < count; ++i) squares[i] = (offset[i] - body * column[i]).squaredNorm();
    fit.cost = mean_cost(squares);
    scale = reweigh(squares, weights);
  }
  fit.body_sigma = std::sqrt(scale / std::max(normal, 1e-300));
  body = std::max(body, 0.0);

  std::vector<double> environment(count);
  for (std::size_t i = 0; i < count; ++i) {
    environment[i] = (samples[i].s0 - body) / fresnel_factors(samples[i].slopes.tan2(), eta).reflectance;
  }
  std::vector<double> reordered = environment;
  const double top = 1.1 * std::max(quantile_in_place(reordered, 0.98), 1e-6);
  constexpr std::size_t bins = 80;
  std::array<double, bins + 2> histogram{};
  for (const double e : environment) {
    if (e >= 0 && e < top) ++histogram[1 + static_cast<std::size_t>(e / top * bins)];
  }
  std::size_t mode = 1;
  double highest = -1;
  for (std::size_t i = 1; i <= bins; ++i) {
    const double smooth = 0.25 * histogram[i - 1] + 0.5 * histogram[i] + 0.25 * histogram[i + 1];
    if (smooth > highest) {
      highest = smooth;
      mode = i;
    }
  }
  const double peak = (static_cast<double>(mode) - 0.5) / bins * top;
  std::vector<double> near;
  for (const double e : environment) {
    if (std::abs(e - peak) < 0.2 * peak) near.push_back(e);
  }
  const double usual = near.empty() ? peak : median(near);
  fit.environment_sigma = robust_spread_about(usual, near);
  fit.mirror = {std::max(body, 1e-3 * usual), usual};
  fit.mirror.body_spread = body_spread(samples, fit.mirror, eta);
  return fit;
}

}  // namespace malus
