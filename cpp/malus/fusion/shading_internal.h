#pragma once

#include <Eigen/Core>

#include "malus/polarization/ray_frame.h"

namespace malus {

/// Light from a body of albedo 1 as a function of its normal: spherical harmonics to the second order, which hold 99 %
/// of a Lambertian body's shading under any distant light (Ramamoorthi and Hanrahan 2001).
using ShadingHarmonics = Eigen::Matrix<double, 9, 1>;

/// Least shading that is distinguished from darkness, relative to the usual light.
inline constexpr double darkest_shading = 0.1;

/// Basis functions of a unit normal, camera frame; the functions are not normalized.
ShadingHarmonics shading_basis(const Eigen::Vector3d& n);

/// ln of the shading of a pixel's normal, with derivatives by its slopes.
struct LogShading {
  double value = 0, by_p = 0, by_q = 0;
};
LogShading log_shading(const ShadingHarmonics& harmonics, const RayFrame& frame, double p, double q);

}  // namespace malus
