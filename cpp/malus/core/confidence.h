#pragma once

#include <algorithm>
#include <array>
#include <string>
#include <string_view>
#include <vector>

namespace malus {

/// How far a surface may be trusted, from evidence and not from the solver: everywhere, in parts that a map shows, or
/// not beyond its prior.
enum class ConfidenceLevel { high, partial, low };
constexpr auto names_of(ConfidenceLevel) {
  return std::to_array<std::string_view>({"high", "partial", "low"});
}

struct Confidence {
  ConfidenceLevel level = ConfidenceLevel::high;
  std::vector<std::string> reasons;  ///< one sentence each, for people; none where the level is high

  /// No more than this level, for this reason.
  void limit(ConfidenceLevel most, std::string reason) {
    level = std::max(level, most);
    reasons.push_back(std::move(reason));
  }

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("level", self.level);
    visit("reasons", self.reasons);
  }
};

}  // namespace malus
