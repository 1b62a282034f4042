#pragma once

#include <Eigen/Core>
#include <vector>

#include "malus/fusion/reflection_sample_internal.h"
#include "malus/fusion/shading_internal.h"

namespace malus {

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

}  // namespace malus
