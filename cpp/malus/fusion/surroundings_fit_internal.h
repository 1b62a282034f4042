#pragma once

#include <span>
#include <vector>

#include "malus/core/context.h"
#include "malus/fusion/reflection_fit_internal.h"
#include "malus/fusion/surroundings.h"

namespace malus {

/// How well surroundings explain the Stokes vectors at known slopes.
struct SurroundingsFit {
  Surroundings surroundings;
  double cost = 0;  ///< mean of ln(1 + r² / 4)
};

/// Fits the radiance of all cells for each roughness and keeps the cheapest. With the light from the body put in from
/// the measured s0, d = s0 − m0, the Stokes residual is linear in the radiances: robust non-negative least squares.
SurroundingsFit fit_surroundings(const std::vector<ReflectionSample>& samples, double eta,
                                 std::span<const double> roughnesses, const Context& context);

}  // namespace malus
