#pragma once

#include <array>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace malus {

/// How much a finding matters.
enum class Severity {
  note,     ///< nothing is wrong, or the data cannot tell
  warning,  ///< a person should look
  error,    ///< certain: the input is wrong
};
constexpr auto names_of(Severity) {
  return std::to_array<std::string_view>({"note", "warning", "error"});
}

/// What a check of the input concluded, in words that a person who is no programmer can act on.
struct Finding {
  std::string check;  ///< what was looked at: "phase", "prior", "size", "encoding", "response", "contrast", "order"
  Severity severity = Severity::note;
  std::string message;
  std::string suggestion;                               ///< what to do; empty = nothing
  std::vector<std::pair<std::string, double>> figures;  ///< what the message rests on, by name

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("check", self.check);
    visit("severity", self.severity);
    visit("message", self.message);
    visit("suggestion", self.suggestion);
    visit("figures", self.figures);
  }

  /// Message and suggestion as one line.
  std::string text() const { return suggestion.empty() ? message : message + "; " + suggestion; }
};

}  // namespace malus
