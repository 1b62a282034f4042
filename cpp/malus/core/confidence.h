#pragma once

#include <algorithm>
#include <array>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "malus/core/field_list.h"

namespace malus {

/// How far a surface may be trusted, judged from evidence and not from the solver.
///   high     the whole surface is finer than its prior, as far as the evidence shows
///   partial  no evidence contradicts the surface, but part or all of it is no better than the prior; see the reasons
///   low      some evidence contradicts the surface: do not use it before checking the reasons
enum class ConfidenceLevel { high, partial, low };
constexpr auto names_of(ConfidenceLevel) {
  return std::to_array<std::string_view>({"high", "partial", "low"});
}

struct Confidence {
  ConfidenceLevel level = ConfidenceLevel::high;
  std::vector<std::string>
      reasons;  ///< one sentence each, for people; a reason for this level comes first; empty if high

  /// Lowers the level to `most` if it is higher, and records the reason.
  void limit(ConfidenceLevel most, std::string reason) {
    reasons.insert(most > level ? reasons.begin() : reasons.end(), std::move(reason));
    level = std::max(level, most);
  }

  MALUS_FIELDS(level, reasons)
};

}  // namespace malus
