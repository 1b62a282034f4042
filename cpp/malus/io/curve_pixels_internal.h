#pragma once

// Private to the library: [polarized].curve_pixels, the pixels whose intensity is shown against the polarizer's angle.

#include <array>
#include <cstddef>
#include <string>
#include <vector>

#include "malus/core/image.h"
#include "malus/io/station_spec.h"

namespace malus {

class TomlTable;

inline constexpr std::size_t most_curve_pixels = 8;

/// The pixels [x, y] in the table [polarized]; none without the key. Throws an input error unless they are at most
/// most_curve_pixels, in whole numbers.
std::vector<std::array<double, 2>> read_curve_pixels(const TomlTable& polarized);

/// Throws an input error for a pixel outside the polarized image. `where` names the pixels in the message.
void require_curve_pixels_in_image(const std::vector<std::array<double, 2>>& pixels, Size size,
                                   const std::string& where);

/// The station with these curve_pixels, (x, y), at most most_curve_pixels. Throws an input error for more pixels, or
/// for a pixel outside the polarized images.
StationFile with_curve_pixels(StationFile station, std::vector<std::array<double, 2>> pixels);

}  // namespace malus
