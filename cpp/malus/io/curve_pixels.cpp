#include <algorithm>
#include <cmath>
#include <sstream>

#include "malus/io/curve_pixels_internal.h"
#include "malus/io/section_reading_internal.h"
#include "malus/io/station_sections_internal.h"

namespace malus {

std::vector<std::array<double, 2>> read_curve_pixels(const TomlTable& polarized) {
  constexpr std::string_view key = "curve_pixels";
  if (!polarized.has(key)) return {};
  const auto pixels = pairs_of(*polarized.find(key));
  const auto is_whole = [](const std::array<double, 2>& pixel) {
    return pixel[0] == std::floor(pixel[0]) && pixel[1] == std::floor(pixel[1]);
  };
  if (!pixels || pixels->size() > most_curve_pixels || !std::ranges::all_of(*pixels, is_whole))
    throw polarized.wrong(key, "a list of at most 8 pixels, [[x, y], …], in whole numbers");
  return *pixels;
}

void require_curve_pixels_in_image(const std::vector<std::array<double, 2>>& pixels, Size size,
                                   const std::string& where) {
  for (const auto& [x, y] : pixels) {
    if (x >= 0 && y >= 0 && x < size.width && y < size.height) continue;
    std::ostringstream message;
    message << where << " [" << x << ", " << y << "]: expected pixels within the polarized image of " << to_string(size)
            << " pixels";
    throw input_error(message.str());
  }
}

StationFile with_curve_pixels(StationFile station, std::vector<std::array<double, 2>> pixels) {
  if (pixels.size() > most_curve_pixels)
    throw input_error("pixels: " + std::to_string(pixels.size()) + ", expected at most " +
                      std::to_string(most_curve_pixels));
  const std::optional<Size> images = size_of_images(station, "[polarized].images");
  require_curve_pixels_in_image(pixels, images ? *images : size_of_camera(station), "pixel");
  station.polarized.curve_pixels = std::move(pixels);
  return station;
}

}  // namespace malus
