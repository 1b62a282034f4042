#pragma once

#include <array>
#include <vector>

#include "malus/core/context.h"
#include "malus/fusion/reflection_model_internal.h"
#include "malus/fusion/reflection_sample_internal.h"
#include "malus/options/fusion_options.h"

namespace malus {

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

}  // namespace malus
