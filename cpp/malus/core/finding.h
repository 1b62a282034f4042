#pragma once

#include <array>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "malus/core/field_list.h"

namespace malus {

/// How much a finding matters.
enum class Severity {
  note,     ///< nothing is wrong, or the data cannot decide
  caution,  ///< the input is correct, but it degrades parts of the result
  warning,  ///< a person should look
  error,    ///< certain: the input is wrong
};
constexpr auto names_of(Severity) {
  return std::to_array<std::string_view>({"note", "caution", "warning", "error"});
}

/// Result of a check of the input, worded so that a person who is not a programmer can act on it.
struct Finding {
  /// What was checked: "phase", "prior", "size", "encoding" (linear or for a display), "curve" (of which display),
  /// "exposures", "mask" (orientation), "response", "contrast", "order", "registration", "misfits", "scale" (of the
  /// polarizer), …
  std::string check;
  Severity severity = Severity::note;
  std::string message;
  std::string suggestion;                               ///< what to do; empty = nothing
  std::vector<std::pair<std::string, double>> figures;  ///< numbers that support the message, by name

  MALUS_FIELDS(check, severity, message, suggestion, figures)

  /// Message and suggestion as one line.
  std::string text() const { return suggestion.empty() ? message : message + "; " + suggestion; }
};

}  // namespace malus
