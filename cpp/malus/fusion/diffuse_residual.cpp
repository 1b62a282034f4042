#include <cmath>

#include "malus/fusion/diffuse_residual_internal.h"
#include "malus/fusion/fresnel_factors_internal.h"

namespace malus {

LinearizedSample linearize(const ReflectionSample& s, double eta) {
  const FresnelFactors f = fresnel_factors(s.slopes.tan2(), eta);
  const Eigen::Vector2d direction = s.slopes.direction() / s.sigma;
  return {Eigen::Vector2d(s.s1, s.s2) / s.sigma - s.s0 * f.diffuse * direction,
          -(f.specular + f.reflectance * f.diffuse) * direction,
          EnvironmentProfile::position(std::atan(std::sqrt(s.slopes.tan2())))};
}

Eigen::Vector2d lobe_column(const ReflectionSample& s, const HighlightLobe& lobe, double eta) {
  const LobeAtPixel at(lobe.light, s.frame, eta);
  const double x = at.density(s.slopes.p, s.slopes.q, lobe.roughness).value;
  const double diffuse = fresnel_factors(s.slopes.tan2(), eta).diffuse;
  return -x / s.sigma * (Eigen::Vector2d(at.stokes1, at.stokes2) + at.reflectance * diffuse * s.slopes.direction());
}

}  // namespace malus
