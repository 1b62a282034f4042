#pragma once

#include <string>
#include <variant>

#include "arrays.h"
#include "malus/io/image_file_internal.h"

namespace malus::python {

/// A photo as Python hands it over: the path of its file, so that it is in memory once, or its intensity.
using PhotoSource = std::variant<std::string, Array<float>>;

/// Takes no interpreter: of an array only the memory is read.
inline Image<float> intensity_of(const PhotoSource& photo) {
  if (const auto* path = std::get_if<std::string>(&photo)) return read_intensity(*path);
  return to_image(std::get<Array<float>>(photo));
}

}  // namespace malus::python
