#include <algorithm>
#include <cmath>
#include <set>
#include <sstream>

#include "malus/core/length_unit_internal.h"
#include "malus/io/colmap_model_internal.h"
#include "malus/io/colmap_workspace_internal.h"
#include "malus/io/curve_pixels_internal.h"
#include "malus/io/given_scale_internal.h"
#include "malus/io/section_reading_internal.h"
#include "malus/io/station_file_internal.h"
#include "malus/io/station_sections_internal.h"
#include "malus/io/station_tables_internal.h"
#include "malus/io/toml_document_internal.h"
#include "malus/io/toml_table_internal.h"

namespace malus {
namespace {

/// Keys of a prior's surface.
const Keys surface_keys{"cloud", "mesh", "depth", "plane", "sphere", "cylinder"};
std::string read_unit(const TomlTable& table, const std::string& otherwise) {
  Keys names;
  for (const LengthUnit& unit : length_units) names.push_back(unit.name);
  return table.text_among("unit", names).value_or(otherwise);
}

// ---- the rest ----

constexpr Range coordinate_range{-1e12, 1e12}, length_range{1e-12, 1e12};

Eigen::Vector3d read_point(const TomlTable& table, std::string_view key) {
  const auto values =
      table.required(table.numbers_exactly<3>(key, coordinate_range), key, "three coordinates, [x, y, z]");
  return {values[0], values[1], values[2]};
}

Eigen::Vector3d read_direction(const TomlTable& table, std::string_view key) {
  const Eigen::Vector3d direction = read_point(table, key);
  if (!(direction.norm() > 0)) throw table.wrong(key, "a direction, not all zero");
  return direction;
}

double read_radius(const TomlTable& table) {
  return table.required(table.number("radius", length_range), "radius", "a length in the station's unit");
}

/// [prior].plane, .sphere or .cylinder; nothing without them.
std::optional<Shape> read_shape(const TomlTable& table) {
  if (const auto plane = table.section("plane", keys_of(PlaneShape{})))
    return PlaneShape{read_point(*plane, "point"), read_direction(*plane, "normal")};
  if (const auto sphere = table.section("sphere", keys_of(SphereShape{})))
    return SphereShape{read_point(*sphere, "center"), read_radius(*sphere)};
  if (const auto cylinder = table.section("cylinder", keys_of(CylinderShape{}))) {
    return CylinderShape{read_point(*cylinder, "point"), read_direction(*cylinder, "axis"), read_radius(*cylinder)};
  }
  return std::nullopt;
}

/// File or shape of [prior]; nothing if the surface itself is in memory.
std::optional<PriorFile> read_prior(const TomlTable& table, bool in_memory) {
  const auto given = std::ranges::count_if(surface_keys, [&](std::string_view key) { return table.has(key); });
  if (given == 0 && in_memory) return std::nullopt;
  if (given != 1) {
    throw table.error("cloud", "[prior] has " + std::to_string(given) +
                                   " surfaces, expected exactly one of cloud, mesh, depth, plane, sphere and cylinder");
  }
  if (const std::optional<Shape> shape = read_shape(table)) {
    if (!table.has("sigma")) {
      throw table.error("sigma", "is missing, expected how far the object is from the " + std::string(name_of(*shape)) +
                                     ", one standard deviation in the station's unit");
    }
    return *shape;
  }
  if (table.has("mesh")) return MeshFile{*table.existing_file("mesh")};
  if (table.has("depth")) return DepthFile{*table.existing_file("depth")};
  const std::filesystem::path folder = table.resolve("cloud", *table.text("cloud"));
  if (!std::filesystem::is_directory(folder)) return CloudFile{*table.existing_file("cloud")};
  try {
    colmap_workspace_files(folder);
  } catch (const Error& error) {
    throw table.error("cloud", std::string("is a folder, but no COLMAP dense workspace: ") + error.what());
  }
  return CloudFile{folder};
}

PhotosSpec read_photos(const TomlTable& table) {
  PhotosSpec spec;
  spec.folder =
      table.resolve("folder", table.required(table.text("folder"), "folder", "the folder of the photographs"));
  if (!std::filesystem::is_directory(spec.folder)) throw table.wrong("folder", "an existing folder");
  spec.exclude = table.texts("exclude").value_or(std::vector<std::string>{});
  if (const auto masks = table.text("masks")) {
    spec.masks = table.resolve("masks", *masks);
    if (!std::filesystem::is_directory(*spec.masks)) throw table.wrong("masks", "an existing folder");
  }
  spec.camera = lens_in(table);
  return spec;
}

std::optional<PhotosSpec> photos_in(const TomlTable& document) {
  const auto table = document.section("photos", keys_of(PhotosSpec{}));
  return table ? std::optional(read_photos(*table)) : std::nullopt;
}

/// The tables of a file that may have any others, too, such as that of an object.
TomlTable any_tables(const toml::table& root, const std::filesystem::path& path) {
  Keys all;
  for (const auto& entry : root) all.push_back(entry.first.str());
  return {root, path, "", all};
}

std::optional<PhotosSpec> photos_in_file(const std::filesystem::path& given_path) {
  const std::filesystem::path path = std::filesystem::absolute(given_path).lexically_normal();
  const toml::table root = read_toml(path, "file");
  return photos_in(any_tables(root, path));
}

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
    bar.targets_dictionary = table.required(table.text("targets_dictionary"), "targets_dictionary",
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

/// Reads all bars; the bars of a given prior scale the prior and the camera's position.
void read_scale_bars(const TomlTable& document, StationFile& station, bool has_prior) {
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

PatchSpec read_patch(const TomlTable& table, std::string name, Size size) {
  const auto box = table.required(table.numbers_exactly<4>("box"), "box", "the corners [x0, y0, x1, y1] in pixels");
  for (const double corner : box) {
    if (corner != std::floor(corner)) throw table.wrong("box", "whole numbers");
  }
  const bool inside = box[0] >= 0 && box[1] >= 0 && box[2] < size.width && box[3] < size.height;
  if (!inside || box[0] > box[2] || box[1] > box[3]) {
    throw table.wrong("box", "x0 ≤ x1 and y0 ≤ y1 within the polarized image of " + to_string(size) + " pixels");
  }
  return {std::move(name), static_cast<int>(box[0]), static_cast<int>(box[1]), static_cast<int>(box[2]),
          static_cast<int>(box[3])};
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

/// Reads [[patch]] and [[profile]], and checks that [polarized].curve_pixels lie in the image.
void read_regions(const TomlTable& document, Size size, StationFile& station) {
  require_curve_pixels_in_image(station.polarized.curve_pixels, size, document.where("[polarized].curve_pixels"));
  std::set<std::string> names;
  for (const TomlTable& table : document.tables("patch", {"name", "box"}, "tables [[patch]]"))
    station.patches.push_back(read_patch(table, read_name(table, station.patches.size(), names), size));
  names.clear();
  for (const TomlTable& table : document.tables("profile", keys_of(ProfileSpec{}), "tables [[profile]]"))
    station.profiles.push_back(read_profile(table, read_name(table, station.profiles.size(), names), size));
}

}  // namespace

StationFile read_station_tables(const toml::table& root, const std::filesystem::path& path, const GivenInMemory* given,
                                const std::optional<PhotosSpec>& shared_photos) {
  StationFile station;
  station.path = path;
  Keys known{"station", "object", "polarized", "optics", "prior", "photos", "scale", "control", "patch", "profile"};
  if (given == nullptr) known.emplace_back("camera");
  const TomlTable document(root, path, "", known);

  station.name = path.parent_path().filename().string();
  if (const auto table = document.section("station", {"name", "unit"})) {
    station.name = table->text("name").value_or(station.name);
    station.unit = read_unit(*table, station.unit);
  }
  if (const auto table = document.section("object", keys_of(ObjectSpec{}))) read_fields(*table, station.object);
  station.polarized = read_polarized(document, given);
  station.optics = read_optics(document, given);
  station.photos = document.has("photos") ? photos_in(document) : shared_photos;
  const bool prior_in_memory = given != nullptr && given->has_prior;
  if (const auto table = document.section("prior", joined({surface_keys, {"sigma"}}))) {
    station.prior = read_prior(*table, prior_in_memory);
    station.prior_sigma = table->number("sigma", length_range);
  }
  station.control = read_control(document, station);
  std::optional<Size> images;
  if (given != nullptr) {
    station.camera = given->camera;
    images = given->image_size;
  } else {
    images = size_of_images(station, document.where("[polarized].images"));
  }
  read_camera(document, images, station);
  const bool has_prior = station.prior || prior_in_memory;
  if (has_prior && !station.camera) {
    const std::string why_not_found = "; with [prior], the camera is not looked for in [photos]";
    throw document.error("camera", "is missing, expected [camera], in whose view the prior is to be seen" +
                                       (station.photos ? why_not_found : std::string()));
  }
  read_scale_bars(document, station, has_prior);

  if (given != nullptr) station.polarized.images.clear();
  if (!station.control.empty() && !station.camera && !station.frame_is_of_photos())
    throw document.error("control", "needs [camera] with the lens (model, width, height, params), whose pose it gives");
  const Size size = images ? *images : size_of_camera(station);
  require_control_in_image(document, station, size);
  read_regions(document, size, station);
  return station;
}

Shape read_shape_table(const toml::table& root) {
  const TomlTable table(root, "shape", "[prior]", {PlaneShape::name, SphereShape::name, CylinderShape::name});
  if (root.size() != 1) {
    throw input_error("shape: " + std::to_string(root.size()) +
                      " shapes, expected exactly one of plane, sphere and cylinder");
  }
  return *read_shape(table);
}

StationFile read_station_file(const std::filesystem::path& given_path,
                              const std::optional<std::filesystem::path>& photos_of) {
  const std::filesystem::path path = std::filesystem::absolute(given_path).lexically_normal();
  const toml::table root = read_toml(path, "station file");
  const bool has_surface = root.contains("photos") || root.contains("prior");
  const auto shared = photos_of && !has_surface ? photos_in_file(*photos_of) : std::nullopt;
  return read_station_tables(root, path, nullptr, shared);
}

StationFile read_photos_tables(const std::filesystem::path& path) {
  StationFile station;
  station.path = std::filesystem::absolute(path).lexically_normal();
  const toml::table root = read_toml(station.path, "file");
  const TomlTable document = any_tables(root, station.path);
  station.photos = photos_in(document);
  station.control = read_control(document, station);
  read_scale_bars(document, station, false);
  return station;
}

}  // namespace malus
