#pragma once

#include <array>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "malus/core/field_list.h"

namespace malus {

/// What was checked.
enum class Check {
  registration,  ///< of the images
  order,         ///< of the images or of a mosaic's cell
  encoding,      ///< of the image files: linear, or for a display
  curve,         ///< for which display the image files are encoded
  exposures,     ///< exposure times of the image files
  mask,          ///< orientation of images and mask
  response,      ///< of the camera: whether the images are linear
  misfits,       ///< pixels that do not follow the sinusoid
  angles,        ///< of the polarizer, and exposures, as fitted to the images
  scale,         ///< zero and direction of the polarizer's scale
  polarization,  ///< whether anything is polarized
  texture,       ///< finer than the cells of a mosaic
  contrast,      ///< of the images against the cloud's colors
  size,          ///< of the object, and its distance
  phase,         ///< against the prior's slopes
  prior,         ///< its place in the images
};
constexpr auto names_of(Check) {
  return std::to_array<std::string_view>({"registration", "order", "encoding", "curve", "exposures", "mask", "response",
                                          "misfits", "angles", "scale", "polarization", "texture", "contrast", "size",
                                          "phase", "prior"});
}

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
  Check check{};
  Severity severity = Severity::note;
  std::string message;
  std::string suggestion;                               ///< what to do; empty = nothing
  std::vector<std::pair<std::string, double>> figures;  ///< numbers that support the message, by name

  MALUS_FIELDS(check, severity, message, suggestion, figures)

  /// Message and suggestion as one line.
  std::string text() const { return suggestion.empty() ? message : message + "; " + suggestion; }
};

}  // namespace malus
