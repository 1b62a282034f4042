#include <set>
#include <sstream>

#include "malus/io/section_reading_internal.h"
#include "malus/io/station_sections_internal.h"

namespace malus {

std::vector<ControlPoint> read_control(const TomlTable& document, const StationFile& station) {
  std::vector<ControlPoint> points;
  std::set<std::string> names;
  for (const TomlTable& table : document.tables("control", keys_of(ControlPoint{}), "tables [[control]]")) {
    ControlPoint point;
    point.name = read_name(table, points.size(), names);
    point.xyz = table.required(table.numbers_exactly<3>("xyz"), "xyz", "the coordinates [X, Y, Z]");
    point.pixel = table.numbers_exactly<2>("pixel");
    point.marks = read_marks(table, "marks", station.photos);
    point.check = table.boolean("check").value_or(false);
    if (!station.frame_is_of_photos() && !point.pixel)
      throw table.error("pixel", "is missing, expected the point's place [x, y] in the polarized image");
    if (!point.pixel && point.marks.empty())
      throw table.error("marks", "is missing, expected marks in photos, or the point's `pixel` in the polarized image");
    points.push_back(std::move(point));
  }
  return points;
}

void require_control_in_image(const TomlTable& document, const StationFile& station, Size size) {
  for (const ControlPoint& point : station.control) {
    if (!point.pixel) continue;
    const auto& [x, y] = *point.pixel;
    if (x >= -0.5 && y >= -0.5 && x <= size.width - 0.5 && y <= size.height - 0.5) continue;
    std::ostringstream message;
    message << "point " << point.name << " has pixel = [" << x << ", " << y
            << "], expected a place within the polarized image of " << to_string(size) << " pixels";
    throw document.error("control", message.str());
  }
}

}  // namespace malus
