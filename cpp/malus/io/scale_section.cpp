#include <cmath>

#include "malus/io/colmap_model_internal.h"
#include "malus/io/given_scale_internal.h"
#include "malus/io/section_reading_internal.h"
#include "malus/io/station_sections_internal.h"

namespace malus {
namespace {

ScaleBar read_scale_bar(const TomlTable& table, const std::optional<PhotosSpec>& photos) {
  ScaleBar bar;
  bar.distance = table.required(table.number("distance", positive_range), "distance", "a length in the station's unit");
  bar.check = table.boolean("check").value_or(false);
  for (const std::string_view key : {"a_xyz", "b_xyz"}) {
    if (!table.has(key)) continue;
    if (photos) throw table.error(key, "is a point of a given prior's frame; with [photos] mark it in them: a, b");
    refuse(table, {"a", "b", "targets"}, "cannot be given together with a_xyz and b_xyz");
    bar.a_xyz = table.required(table.numbers_exactly<3>("a_xyz"), "a_xyz", "a point [x, y, z]");
    bar.b_xyz = table.required(table.numbers_exactly<3>("b_xyz"), "b_xyz", "a point [x, y, z]");
  }
  if (bar.a_xyz) return bar;
  if (!photos)
    refuse(table, {"targets"}, "are found in [photos]; for a given prior mark the ends (a, b) or give a_xyz and b_xyz");
  if (table.has("targets")) {
    refuse(table, {"a", "b"}, "cannot be given together with targets");
    const auto targets = *table.numbers_exactly<2>("targets", {0, 1e6});
    if (targets[0] == targets[1] || targets[0] != std::floor(targets[0]) || targets[1] != std::floor(targets[1])) {
      throw table.wrong("targets", "two different target numbers");
    }
    bar.targets = std::array{static_cast<int>(targets[0]), static_cast<int>(targets[1])};
    bar.targets_dictionary = table.required(table.choice<TargetDictionary>("targets_dictionary"), "targets_dictionary",
                                            "the targets' dictionary, such as \"aruco_4x4_50\"");
  } else {
    refuse(table, {"targets_dictionary"}, "needs `targets`");
    for (const std::string_view key : {"a", "b"}) {
      std::vector<ImageMark>& end = key == "a" ? bar.a : bar.b;
      end = read_marks(table, key, photos);
      if (end.size() < 2) {
        throw table.error(key,
                          "has " + std::to_string(end.size()) + " marks, expected two or more, in different " +
                              (photos ? "photos" : "images of colmap_model, or points of the prior (a_xyz, b_xyz)"));
      }
    }
  }
  return bar;
}

}  // namespace

void read_scale_bars(const TomlTable& document, bool has_prior, StationFile& station) {
  const std::vector<TomlTable> bars = document.tables("scale", keys_of(ScaleBar{}), "tables [[scale]]");
  if (bars.empty()) return;
  if (!station.control.empty()) {
    throw document.error("scale",
                         "cannot be given together with [[control]]: the control points give the size, and those with "
                         "check = true show how good it is");
  }
  if (station.photos && has_prior) {
    throw document.error("scale",
                         "would not be used: the surface is that of [prior], and [photos] only accompany it; leave "
                         "[photos] out to scale the prior, or [prior] to make one from the photos");
  }
  if (!station.photos && !(has_prior && station.camera)) {
    throw document.error("scale",
                         "needs [photos], in which its ends are marked, or [prior] and [camera], which it scales");
  }
  for (const TomlTable& bar : bars) station.scale_bars.push_back(read_scale_bar(bar, station.photos));
  if (station.photos) return;
  std::optional<ColmapModel> model;
  if (!station.camera_files.empty())
    model = read_colmap_model(station.camera_files.front().parent_path(), ColmapParts::cameras_and_images);
  GivenScale scale = given_scale(station.scale_bars, model ? &*model : nullptr, station.path.string() + ": [[scale]]");
  station.prior_scale = scale.factor;
  station.scale_errors = std::move(scale.errors);
  station.camera->pose.translation *= scale.factor;
}

}  // namespace malus
