#pragma once

#include <Eigen/Core>
#include <vector>

#include "malus/fusion/reflection_model_internal.h"
#include "malus/fusion/reflection_sample_internal.h"

namespace malus {

inline constexpr int environment_nodes = EnvironmentProfile::node_count;

/// The Stokes residual of a diffuse pixel is linear in the environment nodes and the lobe's strength:
/// base − Σ_j E_j env hat_j − k lobe, in units of sigma.
struct LinearizedSample {
  Eigen::Vector2d base, environment;
  EnvironmentProfile::Position position;
};

/// The residual of a sample for a refractive index eta.
LinearizedSample linearize(const ReflectionSample& sample, double eta);

/// What a lobe of strength 1 adds to the residual, with the opposite sign.
Eigen::Vector2d lobe_column(const ReflectionSample& sample, const HighlightLobe& lobe, double eta);

/// Samples with their residuals for a refractive index eta.
struct SampleSet {
  const std::vector<ReflectionSample>& samples;
  const std::vector<LinearizedSample>& linear;
  double eta;
};

}  // namespace malus
