#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>

#include "malus/io/geotiff_file_internal.h"
#include "malus/surface/dem_file_internal.h"

namespace malus {
namespace {

constexpr int usual_digits = 12, digits_of_a_double = 17;

/// Three numbers with this many digits, and with points in every locale.
std::string text_of(const Eigen::Vector3d& vector, int digits = usual_digits) {
  std::string text;
  for (const double value : vector) {
    std::array<char, 32> word;
    const auto [end, error] =
        std::to_chars(word.data(), word.data() + word.size(), value, std::chars_format::general, digits);
    if (!text.empty()) text += ' ';
    text.append(word.data(), end);
  }
  return text;
}

/// So many that the origin keeps a thousandth of a pixel, also far from the world's origin (a national grid in
/// millimeters or micrometers).
int digits_of_origin(const Dem& dem) {
  const double pixels = std::min(dem.origin.cwiseAbs().maxCoeff() / dem.pixel, 1e15);
  if (!(pixels > 1)) return usual_digits;
  return std::clamp(static_cast<int>(std::ceil(std::log10(pixels))) + 4, usual_digits, digits_of_a_double);
}

}  // namespace

void write_dem(const std::filesystem::path& path, const Dem& dem, const LengthUnit& unit, const std::string& name) {
  write_geotiff(path, dem.elevation,
                {.pixel = dem.pixel,
                 .unit = unit,
                 .title = name + ": plane fitted to the object",
                 .metadata = {{"WORLD_ORIGIN", text_of(dem.origin, digits_of_origin(dem))},
                              {"WORLD_X_AXIS", text_of(dem.right)},
                              {"WORLD_Y_AXIS", text_of(dem.up)},
                              {"WORLD_Z_AXIS", text_of(dem.normal)}}});
}

}  // namespace malus
