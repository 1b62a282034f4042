#pragma once

#include <array>
#include <string_view>

namespace malus {

/// How an adjustment of cameras, points or scale ended. With too few matches the model stays unchanged.
enum class AdjustmentStatus { not_run, converged, not_converged, too_few_matches };
constexpr auto names_of(AdjustmentStatus) {
  return std::to_array<std::string_view>({"not run", "converged", "not converged", "too few matches"});
}

}  // namespace malus
