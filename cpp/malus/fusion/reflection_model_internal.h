#pragma once

#include <Eigen/Core>
#include <array>
#include <memory>

#include "malus/core/degrees_internal.h"
#include "malus/polarization/ray_frame.h"
#include "malus/polarization/reflection.h"

namespace malus {

/// Radiance of the mirrored surroundings as a function of the zenith: piecewise linear, not negative, in units of s0.
struct EnvironmentProfile {
  static constexpr int node_count = 9;
  static constexpr std::array<double, node_count> nodes_rad = [] {
    std::array<double, node_count> nodes{0, 35, 45, 52, 58, 64, 70, 76, 89};
    for (double& node : nodes) node *= to_radians(1);
    return nodes;
  }();
  std::array<double, node_count> radiance{};

  /// Lower node of a zenith's interval and the weight of the upper node.
  struct Position {
    int node = 0;
    double share = 0;

    /// The value there, linear between the nodes'.
    double between(const double* values) const { return (1 - share) * values[node] + share * values[node + 1]; }
  };
  static Position position(double zenith_rad);
  double value(double zenith_rad) const;
  /// Derivative by the zenith, per radian.
  double slope(double zenith_rad) const;
};

/// Rough reflection of a small source: a microfacet lobe about the half vector of light and view. Its light is
/// polarized about the half vector, like that of its facets, and not about the normal.
struct HighlightLobe {
  double strength = 0;                                ///< 0 = none
  double roughness = 0.25;                            ///< alpha of the Beckmann distribution
  Eigen::Vector3d light = -Eigen::Vector3d::UnitZ();  ///< unit, towards the light, camera frame
};

/// Specular-dominated reflection, typical values over the object.
struct MirrorReflection {
  double body = 0;           ///< s0 of light from inside the body
  double environment = 0;    ///< radiance of most of the surroundings
  double body_spread = 0.2;  ///< robust relative standard deviation of the body light over the object
};

class MirroredLightTable;

/// All reflection parameters that the pixels share.
struct ReflectionModel {
  double eta = 1.5;
  /// Light mirrored by pixels that are not specular; null = environment and lobe are used instead.
  std::shared_ptr<const MirroredLightTable> mirrored;
  /// The same for pixels with the other of two finishes; null = all pixels have the same finish.
  std::shared_ptr<const MirroredLightTable> mirrored_by_other;
  /// For a metal, which mirrors all its light: standard deviation of the predicted s0 relative to s0. 0 = no metal.
  double metal_error = 0;
  EnvironmentProfile environment;
  HighlightLobe lobe;
  MirrorReflection mirror;

  const MirroredLightTable* table_of(bool other_finish) const {
    return (other_finish && mirrored_by_other ? mirrored_by_other : mirrored).get();
  }
};

/// The lobe at one pixel. Slopes are in the frame of the pixel's viewing ray.
struct LobeAtPixel {
  double hp = 0, hq = 0;            ///< slopes of the half vector
  double reflectance = 0;           ///< Fresnel F about the half vector
  double stokes1 = 0, stokes2 = 0;  ///< polarized reflectance (Rs − Rp) / 2 about it, with its azimuth

  LobeAtPixel() = default;
  LobeAtPixel(const Eigen::Vector3d& light, const RayFrame& frame, double eta);

  /// Facet density exp(−tan²δ / α²) / (α² cos⁴δ) / cosθ with δ between normal and half vector; with derivatives.
  struct Density {
    double value = 0, by_p = 0, by_q = 0;
  };
  Density density(double p, double q, double roughness) const;
};

/// (s1, s2) of a pixel predicted from its slopes and its measured s0, with derivatives by the slopes.
struct PredictedStokes {
  double s1 = 0, s1_by_p = 0, s1_by_q = 0;
  double s2 = 0, s2_by_p = 0, s2_by_q = 0;
  double body = 0;                                            ///< s0 of the light from inside the body, not negative
  double mirrored = 0, mirrored_by_p = 0, mirrored_by_q = 0;  ///< s0 of the mirrored light; derivatives with a map only
};

/// Forward model of one pixel:
///   (s1, s2) = (d ρ_d/g − E (Rs−Rp)/2/g) (p² − q², 2 p q) − T (cos 2φ_H, sin 2φ_H),  g = p² + q² = tan²θ.
/// Diffuse: d = max(s0 − E(θ) F − T_unpolarized, 0). Specular: d is given, E = (s0 − d) / F, T = 0. With the measured
/// s0 the albedo is no unknown. With a table of mirrored light m: d = max(s0 − m0, 0), (s1, s2) = d ρ_d/g (p² − q²,
/// 2 p q) + (m1, m2); for a metal d = 0, and s0 = m0 is predicted, too.
class PixelReflection {
 public:
  /// mirror_body: s0 of the light from inside a specular body, from 0 to s0; not used for a diffuse one. other_finish:
  /// whether the pixel has the other of the two finishes of a map of the surroundings.
  PixelReflection(const ReflectionModel& model, Reflection kind, double s0, double mirror_body, const RayFrame& frame,
                  bool other_finish = false);

  PredictedStokes predict(double p, double q) const;

 private:
  PredictedStokes predict_diffuse(double p, double q) const;
  PredictedStokes predict_mirroring(double p, double q) const;
  PredictedStokes predict_specular(double p, double q) const;

  const ReflectionModel& model_;
  Reflection kind_;
  double s0_, mirror_body_;
  RayFrame frame_;
  const MirroredLightTable* mirrored_;
  LobeAtPixel lobe_;
};

}  // namespace malus
