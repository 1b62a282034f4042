#include <cmath>
#include <set>

#include "malus/io/section_reading_internal.h"
#include "malus/io/station_sections_internal.h"

namespace malus {
namespace {

PatchSpec read_patch(const TomlTable& table, std::string name, Size size) {
  const auto box = table.required(table.numbers_exactly<4>("box"), "box", "the corners [x0, y0, x1, y1] in pixels");
  for (const double corner : box) {
    if (corner != std::floor(corner)) throw table.wrong("box", "whole numbers");
  }
  const bool inside = box[0] >= 0 && box[1] >= 0 && box[2] < size.width && box[3] < size.height;
  if (!inside || box[0] > box[2] || box[1] > box[3]) {
    throw table.wrong("box", "x0 ≤ x1 and y0 ≤ y1 within the polarized image of " + to_string(size) + " pixels");
  }
  return {std::move(name),
          {static_cast<int>(box[0]), static_cast<int>(box[1]), static_cast<int>(box[2]), static_cast<int>(box[3])}};
}

ProfileSpec read_profile(const TomlTable& table, std::string name, Size size) {
  ProfileSpec profile;
  profile.name = std::move(name);
  const auto end = [&](std::string_view key) {
    const auto pixel = table.required(table.numbers_exactly<2>(key), key, "a pixel [x, y]");
    if (!(pixel[0] >= 0 && pixel[1] >= 0 && pixel[0] <= size.width - 1 && pixel[1] <= size.height - 1)) {
      throw table.wrong(key, "a pixel [x, y] within the polarized image of " + to_string(size) + " pixels");
    }
    return pixel;
  };
  profile.from = end("from");
  profile.to = end("to");
  if (profile.from == profile.to) throw table.wrong("to", "another pixel than `from`");
  return profile;
}

}  // namespace

void read_regions(const TomlTable& document, Size size, StationFile& station) {
  std::set<std::string> names;
  for (const TomlTable& table : document.tables("patch", keys_of(PatchSpec{}), "tables [[patch]]"))
    station.patches.push_back(read_patch(table, read_name(table, station.patches.size(), names), size));
  names.clear();
  for (const TomlTable& table : document.tables("profile", keys_of(ProfileSpec{}), "tables [[profile]]"))
    station.profiles.push_back(read_profile(table, read_name(table, station.profiles.size(), names), size));
}

}  // namespace malus
