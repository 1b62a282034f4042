#pragma once

#include <algorithm>
#include <array>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "malus/core/field_list.h"

namespace malus {

/// How far a surface may be trusted, from evidence and not from the solver.
///   high     all of it is finer than its prior, as far as anything tells
///   partial  nothing is wrong, but some of it, or all, is no better known than the prior; the reasons say which
///   low      something contradicts the surface: it is not to be used before the reasons are looked into
enum class ConfidenceLevel { high, partial, low };
constexpr auto names_of(ConfidenceLevel) {
  return std::to_array<std::string_view>({"high", "partial", "low"});
}

struct Confidence {
  ConfidenceLevel level = ConfidenceLevel::high;
  std::vector<std::string>
      reasons;  ///< one sentence each, for people, one of the level's own first; none if it is high

  /// No more than this level, for this reason.
  void limit(ConfidenceLevel most, std::string reason) {
    reasons.insert(most > level ? reasons.begin() : reasons.end(), std::move(reason));
    level = std::max(level, most);
  }

  MALUS_FIELDS(level, reasons)
};

}  // namespace malus
