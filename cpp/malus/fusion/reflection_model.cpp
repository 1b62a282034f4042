#include <algorithm>
#include <cmath>

#include "malus/fusion/fresnel_factors_internal.h"
#include "malus/fusion/reflection_model_internal.h"
#include "malus/fusion/surroundings_internal.h"

namespace malus {
namespace {

/// m = gain · (direction of the slopes) added to a prediction.
void add_slope_term(double gain, double gain_by_p, double gain_by_q, const Slopes& slopes, PredictedStokes& out) {
  const Eigen::Vector2d direction = slopes.direction();
  out.s1 += gain * direction[0];
  out.s1_by_p += gain_by_p * direction[0] + gain * 2 * slopes.p;
  out.s1_by_q += gain_by_q * direction[0] - gain * 2 * slopes.q;
  out.s2 += gain * direction[1];
  out.s2_by_p += gain_by_p * direction[1] + gain * 2 * slopes.q;
  out.s2_by_q += gain_by_q * direction[1] + gain * 2 * slopes.p;
}

}  // namespace

EnvironmentProfile::Position EnvironmentProfile::position(double zenith_rad) {
  const auto above = std::upper_bound(nodes_rad.begin() + 1, nodes_rad.end() - 1, zenith_rad);
  const int node = static_cast<int>(above - nodes_rad.begin()) - 1;
  const auto i = static_cast<std::size_t>(node);
  return {node, std::clamp((zenith_rad - nodes_rad[i]) / (nodes_rad[i + 1] - nodes_rad[i]), 0.0, 1.0)};
}

double EnvironmentProfile::value(double zenith_rad) const {
  const Position at = position(zenith_rad);
  const auto i = static_cast<std::size_t>(at.node);
  return radiance[i] + at.share * (radiance[i + 1] - radiance[i]);
}

double EnvironmentProfile::slope(double zenith_rad) const {
  if (zenith_rad >= nodes_rad.back()) return 0;
  const auto i = static_cast<std::size_t>(position(zenith_rad).node);
  return (radiance[i + 1] - radiance[i]) / (nodes_rad[i + 1] - nodes_rad[i]);
}

LobeAtPixel::LobeAtPixel(const Eigen::Vector3d& light, const RayFrame& frame, double eta) {
  const Eigen::Vector3d half = light + frame.view;
  const double along = half.dot(frame.view);
  if (along < 1e-3) return;  // a light from behind has no half vector in front
  hp = half.dot(frame.right) / along;
  hq = half.dot(frame.up) / along;
  const FresnelFactors f = fresnel_factors(hp * hp + hq * hq, eta);
  reflectance = f.reflectance;
  stokes1 = f.specular * (hp * hp - hq * hq);
  stokes2 = f.specular * 2 * hp * hq;
}

LobeAtPixel::Density LobeAtPixel::density(double p, double q, double roughness) const {
  const double slant2 = 1 + p * p + q * q;
  const double dot = 1 + p * hp + q * hq;
  const double half2 = 1 + hp * hp + hq * hq;
  const double cos2 = dot * dot / (slant2 * half2);
  constexpr double smallest_cos2 = 0.0025;
  const double alpha2 = roughness * roughness;
  if (dot <= 0 || cos2 < smallest_cos2) return {};
  const double value = std::exp(-(1 - cos2) / cos2 / alpha2) / (alpha2 * cos2 * cos2) * std::sqrt(slant2);
  const double by_cos2 = value * (1 / (cos2 * cos2 * alpha2) - 2 / cos2);
  const double cos2_by_p = cos2 * 2 * (hp / dot - p / slant2), cos2_by_q = cos2 * 2 * (hq / dot - q / slant2);
  return {value, by_cos2 * cos2_by_p + value * p / slant2, by_cos2 * cos2_by_q + value * q / slant2};
}

PixelReflection::PixelReflection(const ReflectionModel& model, Reflection kind, double s0, double mirror_body,
                                 const RayFrame& frame, bool other_finish)
    : model_(model),
      kind_(kind),
      s0_(s0),
      mirror_body_(mirror_body),
      frame_(frame),
      mirrored_(model.table_of(other_finish)) {
  if (kind == Reflection::diffuse && !model.mirrored && model.lobe.strength > 0)
    lobe_ = LobeAtPixel(model.lobe.light, frame, model.eta);
}

PredictedStokes PixelReflection::predict(double p, double q) const {
  if (kind_ == Reflection::specular) return predict_specular(p, q);
  return model_.mirrored ? predict_mirroring(p, q) : predict_diffuse(p, q);
}

PredictedStokes PixelReflection::predict_mirroring(double p, double q) const {
  const FresnelFactors f = fresnel_factors(p * p + q * q, model_.eta);
  const MirroredLight mirrored = mirrored_->at(p, q, frame_);
  PredictedStokes out;
  out.mirrored = mirrored.stokes[0];
  out.mirrored_by_p = mirrored.by_p[0];
  out.mirrored_by_q = mirrored.by_q[0];
  if (model_.metal_error == 0) out.body = std::max(s0_ - out.mirrored, 0.0);
  const double body_by_p = out.body > 0 ? -mirrored.by_p[0] : 0, body_by_q = out.body > 0 ? -mirrored.by_q[0] : 0;
  add_slope_term(out.body * f.diffuse, body_by_p * f.diffuse + out.body * f.diffuse_slope * 2 * p,
                 body_by_q * f.diffuse + out.body * f.diffuse_slope * 2 * q, {p, q}, out);
  out.s1 += mirrored.stokes[1];
  out.s1_by_p += mirrored.by_p[1];
  out.s1_by_q += mirrored.by_q[1];
  out.s2 += mirrored.stokes[2];
  out.s2_by_p += mirrored.by_p[2];
  out.s2_by_q += mirrored.by_q[2];
  return out;
}

PredictedStokes PixelReflection::predict_diffuse(double p, double q) const {
  const double g = p * p + q * q, tangent = std::sqrt(g);
  const FresnelFactors f = fresnel_factors(g, model_.eta);
  const double zenith = std::atan(tangent);
  const double e = model_.environment.value(zenith);
  // The profile has a kink at normal incidence; the factor g of the polarized terms removes it.
  const double e_by_g = model_.environment.slope(zenith) / (2 * std::max(tangent, 1e-9) * (1 + g));

  LobeAtPixel::Density x;
  if (model_.lobe.strength > 0) x = lobe_.density(p, q, model_.lobe.roughness);
  const double k = model_.lobe.strength;

  PredictedStokes out;
  out.mirrored = e * f.reflectance + k * lobe_.reflectance * x.value;
  out.body = std::max(s0_ - out.mirrored, 0.0);
  const double body_by_g = out.body > 0 ? -(e_by_g * f.reflectance + e * f.reflectance_slope) : 0.0;
  const double body_by_x = out.body > 0 ? -k * lobe_.reflectance : 0.0;

  const double gain = out.body * f.diffuse - e * f.specular;
  const double gain_by_g =
      body_by_g * f.diffuse + out.body * f.diffuse_slope - e_by_g * f.specular - e * f.specular_slope;
  const double gain_by_x = body_by_x * f.diffuse;
  add_slope_term(gain, gain_by_g * 2 * p + gain_by_x * x.by_p, gain_by_g * 2 * q + gain_by_x * x.by_q, {p, q}, out);
  out.s1 -= k * lobe_.stokes1 * x.value;
  out.s1_by_p -= k * lobe_.stokes1 * x.by_p;
  out.s1_by_q -= k * lobe_.stokes1 * x.by_q;
  out.s2 -= k * lobe_.stokes2 * x.value;
  out.s2_by_p -= k * lobe_.stokes2 * x.by_p;
  out.s2_by_q -= k * lobe_.stokes2 * x.by_q;
  return out;
}

PredictedStokes PixelReflection::predict_specular(double p, double q) const {
  const FresnelFactors f = fresnel_factors(p * p + q * q, model_.eta);
  const double mirrored = s0_ - mirror_body_;
  const double ratio = f.specular / f.reflectance;
  const double ratio_by_g = (f.specular_slope - ratio * f.reflectance_slope) / f.reflectance;
  const double gain = mirror_body_ * f.diffuse - mirrored * ratio;
  const double gain_by_g = mirror_body_ * f.diffuse_slope - mirrored * ratio_by_g;
  PredictedStokes out;
  out.body = mirror_body_;
  out.mirrored = mirrored;
  add_slope_term(gain, gain_by_g * 2 * p, gain_by_g * 2 * q, {p, q}, out);
  return out;
}

}  // namespace malus
