#pragma once

#include <vector>

#include "malus/fusion/reflection_model_internal.h"
#include "malus/fusion/reflection_sample_internal.h"

namespace malus {

struct SpecularFit {
  MirrorReflection mirror;
  double cost = 0;
  double body_sigma = 0, environment_sigma = 0;
};

/// Fits the body light and the usual radiance of the surroundings.
SpecularFit fit_specular(const std::vector<ReflectionSample>& samples, double eta);

}  // namespace malus
