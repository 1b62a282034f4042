#pragma once

#include <string>
#include <variant>

#include "arrays.h"
#include "malus/io/image_file_internal.h"

namespace malus::python {

/// A photo from Python: the path of its file, which avoids a second copy in memory, or its intensity.
using PhotoSource = std::variant<std::string, Array<float>>;

/// Needs no GIL: of an array only the memory is read.
inline Image<float> intensity_of(const PhotoSource& photo) {
  if (const auto* path = std::get_if<std::string>(&photo)) return read_intensity(*path);
  return to_image(std::get<Array<float>>(photo));
}

}  // namespace malus::python
