#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <sstream>

#include "malus/core/length_unit_internal.h"
#include "malus/core/metal_internal.h"
#include "malus/core/refractive_index_internal.h"
#include "malus/io/colmap_model_internal.h"
#include "malus/io/colmap_workspace_internal.h"
#include "malus/io/given_scale_internal.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/input_file_internal.h"
#include "malus/io/polarized_files_internal.h"
#include "malus/io/section_reading_internal.h"
#include "malus/io/station_file_internal.h"
#include "malus/io/station_sections_internal.h"
#include "malus/io/station_tables_internal.h"
#include "malus/io/toml_document_internal.h"
#include "malus/io/toml_table_internal.h"

namespace malus {
namespace {

// Angles closer than this on the circle of 180° count as one.
constexpr double distinct_angle_deg = 1e-3;
// Angles that all lie within this on the circle of 180° cannot be meant: one turn in radians is less.
constexpr double least_sector_deg = 6.3;

constexpr std::array<std::string_view, 4> bayer_patterns{"RGGB", "BGGR", "GRBG", "GBRG"};

/// Keys of a prior's surface.
const Keys surface_keys{"cloud", "mesh", "depth", "plane", "sphere", "cylinder"};
std::string read_unit(const TomlTable& table, const std::string& otherwise) {
  Keys names;
  for (const LengthUnit& unit : length_units) names.push_back(unit.name);
  return table.text_among("unit", names).value_or(otherwise);
}

// ---- [polarized] ----

std::array<double, 4> read_mosaic(const TomlTable& table) {
  const auto rows = pairs_of(*table.find("mosaic"));
  if (!rows || rows->size() != 2)
    throw table.wrong("mosaic", "two rows of two angles in degrees, such as [[90, 45], [135, 0]]");
  const auto &top = rows->front(), &bottom = rows->back();
  return {top[0], top[1], bottom[0], bottom[1]};
}

std::vector<std::filesystem::path> read_image_list(const TomlTable& table) {
  std::vector<std::filesystem::path> images;
  if (const toml::node* node = table.find("images"); node && node->is_string()) {
    const std::string place = *table.text("images");
    images = list_images(table.file().parent_path(), place, table.where("images"));
    if (images.empty()) throw table.wrong("images", "a folder with images, or a pattern that matches files");
  } else {
    const auto names =
        table.required(table.texts("images"), "images", "a list of files, a folder or a pattern like \"pol/*.png\"");
    for (const std::string& name : names) images.push_back(table.resolve("images", name));
  }
  constexpr std::size_t most_images = 1000;
  if (images.size() > most_images) {
    throw table.error("images", "are " + std::to_string(images.size()) + ", expected at most " +
                                    std::to_string(most_images) + " of one station");
  }
  std::set<std::filesystem::path> seen;
  for (const auto& image : images) {
    if (!seen.insert(image).second) throw table.error("images", image.string() + " is listed twice");
    require_file(image, table.where("images"));
  }
  return images;
}

/// Steps from angle to angle around the circle of 180°; they add up to 180.
std::vector<double> steps_around(std::vector<double> angles_deg) {
  for (double& angle : angles_deg) angle -= 180 * std::floor(angle / 180);
  std::ranges::sort(angles_deg);
  std::vector<double> steps;
  for (std::size_t i = 0; i < angles_deg.size(); ++i)
    steps.push_back(angles_deg[i] - (i > 0 ? angles_deg[i - 1] : angles_deg.back() - 180));
  return steps;
}

/// Throws unless the angles determine intensity, degree and phase, and can be degrees.
void require_usable_angles(const TomlTable& table, std::string_view key, const std::vector<double>& angles_deg) {
  const std::vector<double> steps = steps_around(angles_deg);
  const auto distinct = std::ranges::count_if(steps, [](double step) { return step > distinct_angle_deg; });
  if (distinct < 3) {
    throw data_error(
        table.where(key) + " has " + std::to_string(distinct) +
        " distinct polarizer angles modulo 180°, expected at least 3: intensity, degree and phase are three unknowns");
  }
  if (180 - std::ranges::max(steps) < least_sector_deg) {
    throw table.error(key,
                      "all angles lie within 6.3°, expected degrees over most of half a turn, such as 0, 45, 90 and "
                      "135; are these radians?");
  }
}

/// Angles of the images: a list, "auto" (nothing), or taken from the file names.
std::optional<std::vector<double>> read_angles(const TomlTable& table,
                                               const std::vector<std::filesystem::path>& images) {
  const toml::node* named = table.find("images");
  const bool listed = named == nullptr || named->is_array();
  const auto pattern = table.text("angle_pattern");
  if (table.has("angles_deg") && pattern)
    throw table.error("angle_pattern", "is not needed with angles_deg, expected one of the two");
  if (table.is_auto("angles_deg")) {
    if (images.size() < 5) {
      throw data_error(table.where("images") + " has " + std::to_string(images.size()) +
                       " images, expected at least 5 polarizer positions to find angles that are not known");
    }
    return std::nullopt;
  }
  std::vector<double> angles;
  std::string_view key = "angles_deg";
  if (table.has("angles_deg")) {
    if (!table.find("angles_deg")->is_array())
      throw table.wrong("angles_deg", "a list of angles in degrees, or \"auto\"");
    angles = *table.numbers("angles_deg");
    if (angles.size() != images.size()) {
      throw table.error("angles_deg", "has " + std::to_string(angles.size()) + " angles for " +
                                          std::to_string(images.size()) + " images, expected one for each");
    }
  } else if (listed && !pattern) {
    throw table.error("angles_deg", "is missing, expected a list of angles in degrees, or \"auto\"");
  } else {
    key = pattern ? "angle_pattern" : "images";
    if (pattern) {
      for (const auto& image : images) angles.push_back(angle_of_name(image, *pattern, table.where(key)));
    } else {
      angles = angles_of_names(images, table.where(key),
                               "expected angles_deg = [ … ], one for each image in this order, or an angle_pattern");
    }
  }
  require_usable_angles(table, key, angles);
  return angles;
}

/// "linear", "srgb", "gamma:2.2", or the absolute path of a lookup table.
std::string read_response(const TomlTable& table) {
  const std::string value = table.text("response").value_or("linear");
  constexpr std::string_view gamma = "gamma:";
  if (value == "linear" || value == "srgb") return value;
  if (value.starts_with(gamma)) {
    const auto exponent = number_of<double>(std::string_view(value).substr(gamma.size()));
    if (exponent && *exponent >= 0.1 && *exponent <= 10) return value;
    throw table.wrong("response", "\"gamma:\" and a number from 0.1 to 10");
  }
  const auto path = table.resolve("response", value);
  if (!std::filesystem::exists(path))
    throw table.wrong("response", "\"linear\", \"srgb\", \"gamma:2.2\" or the file of a lookup table");
  require_file(path, table.where("response"));
  return std::filesystem::absolute(path).string();
}

/// Exposure times, one per image. Every angle must have the same set of times, so that all merged images have equal
/// noise.
std::optional<std::vector<double>> read_exposures(const TomlTable& table, const PolarizedSpec& spec) {
  const auto exposures = table.numbers("exposure_s", positive_range);
  if (!exposures) return std::nullopt;
  if (spec.mosaic || !spec.angles_deg) {
    throw table.error("exposure_s", "needs known angles, one per image: images with the same angle are merged");
  }
  if (exposures->size() != spec.images.size()) {
    throw table.error("exposure_s", "has " + std::to_string(exposures->size()) + " times for " +
                                        std::to_string(spec.images.size()) + " images, expected one for each");
  }
  std::map<double, std::multiset<double>> by_angle;
  for (std::size_t k = 0; k < exposures->size(); ++k) by_angle[(*spec.angles_deg)[k]].insert((*exposures)[k]);
  for (const auto& [angle, times] : by_angle) {
    if (times != by_angle.begin()->second) {
      std::ostringstream message;
      message << "differs between " << by_angle.begin()->first << "° and " << angle
              << "°, expected the same exposures at every angle";
      throw table.error("exposure_s", message.str());
    }
  }
  return exposures;
}

/// A list of pixels [x, y], or none.
std::vector<std::array<double, 2>> read_pixels(const TomlTable& table, std::string_view key) {
  if (!table.has(key)) return {};
  const auto pixels = pairs_of(*table.find(key));
  const auto is_whole = [](const std::array<double, 2>& pixel) {
    return pixel[0] == std::floor(pixel[0]) && pixel[1] == std::floor(pixel[1]);
  };
  if (!pixels || pixels->size() > most_curve_pixels || !std::ranges::all_of(*pixels, is_whole))
    throw table.wrong(key, "a list of at most 8 pixels, [[x, y], …], in whole numbers");
  return *pixels;
}

/// Names of images in memory, for messages.
std::vector<std::filesystem::path> names_of_images(std::size_t count) {
  std::vector<std::filesystem::path> names;
  for (std::size_t k = 0; k < count; ++k) names.emplace_back("images[" + std::to_string(k) + "]");
  return names;
}

PolarizedSpec read_polarized(const TomlTable& table, const GivenInMemory* given) {
  PolarizedSpec spec;
  read_fields(table, spec);
  spec.images = given ? names_of_images(given->image_count) : read_image_list(table);
  if (table.has("mosaic")) {
    spec.mosaic = read_mosaic(table);
    if (spec.images.size() != 1) {
      throw table.error("images", "has " + std::to_string(spec.images.size()) + " files, expected one with `mosaic`");
    }
    refuse(table, {"angles_deg", "angle_pattern"}, "cannot be given together with `mosaic`, which states the angles");
    require_usable_angles(table, "mosaic", {spec.mosaic->begin(), spec.mosaic->end()});
    spec.mosaic_colors = table.text_among("mosaic_colors", bayer_patterns);
    spec.angles_deg = std::vector<double>(spec.mosaic->begin(), spec.mosaic->end());
  } else {
    refuse(table, {"mosaic_colors"}, "is of a `mosaic`, which is not given");
    spec.angles_deg = read_angles(table, spec.images);
  }
  spec.exposure_s = read_exposures(table, spec);
  spec.channel_weights = table.numbers_exactly<3>("channel_weights", not_negative);
  if (spec.channel_weights) {
    refuse(table, {"channel"}, "cannot be given together with channel_weights");
    const auto& weights = *spec.channel_weights;
    if (!(weights[0] + weights[1] + weights[2] > 0))
      throw table.wrong("channel_weights", "weights of which one is positive");
  }

  spec.curve_pixels = read_pixels(table, "curve_pixels");
  spec.response = read_response(table);
  if (spec.white_level && spec.black_level >= *spec.white_level) {
    throw table.wrong("black_level", "less than the white level");
  }
  if (std::ranges::any_of(spec.images, is_raw_name)) {
    refuse(table, {"response", "white_level", "black_level", "mosaic"},
           "is not for RAW files: their metadata state it");
    if (!std::ranges::all_of(spec.images, is_raw_name)) {
      throw table.error("images", "has RAW files and others, expected one kind");
    }
  }
  return spec;
}

// ---- [optics] ----

/// The metal as one text: a list [n, k] becomes "n+ki".
MetalStatement read_metal(const TomlTable& table) {
  const toml::node* const node = table.find("metal");
  if (node == nullptr) return {};
  std::string text;
  if (node->is_string()) text = *table.text("metal");
  if (node->is_array()) {
    const std::array<double, 2> index = *table.numbers_exactly<2>("metal");
    text = metal_index_text(index[0], index[1]);
  }
  std::optional<MetalStatement> metal = read_metal_statement(text);
  if (!metal) throw table.wrong("metal", expected_metal());
  return *metal;
}

/// Sets the kind of reflection: a word, or the file of a label image.
void read_reflection(const TomlTable& table, OpticsSpec& spec) {
  const std::string reflection = table.text("reflection").value_or("auto");
  const auto choice = enum_value<ReflectionChoice>(reflection);
  if (choice && *choice != ReflectionChoice::labels) {
    spec.reflection = *choice;
    return;
  }
  if (!std::filesystem::exists(table.resolve("reflection", reflection))) {
    throw table.wrong("reflection", "\"diffuse\", \"specular\", \"auto\" or the file of a label image");
  }
  spec.label_image = table.existing_file("reflection");
  spec.reflection = ReflectionChoice::labels;
}

OpticsSpec read_optics(const TomlTable& table, const GivenInMemory* given) {
  OpticsSpec spec;
  if (table.is_auto("refractive_index")) {
    spec.refractive_index.reset();
  } else {
    spec.refractive_index = table.number("refractive_index", {least_refractive_index, largest_refractive_index})
                                .value_or(*spec.refractive_index);
  }
  spec.light = table.numbers_exactly<3>("light");
  if (spec.light && !(std::hypot((*spec.light)[0], (*spec.light)[1], (*spec.light)[2]) > 0 && (*spec.light)[2] < 0))
    throw table.wrong("light", "a direction [x, y, z] towards the source with z < 0, on the camera's side");
  read_reflection(table, spec);
  const MetalStatement metal = read_metal(table);
  const bool has_labels = given != nullptr && given->has_labels;
  const auto expected = expected_metal_with(metal, has_labels ? ReflectionChoice::labels : spec.reflection);
  if (expected) throw table.wrong("metal", *expected);
  spec.metal = metal.text;
  return spec;
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

/// Keys of [polarized]; without the keys of files if the images are in memory.
Keys polarized_keys(const GivenInMemory* given) {
  if (given == nullptr) return keys_of(PolarizedSpec{}, {"angle_pattern"});
  Keys keys = keys_of(PolarizedSpec{});
  std::erase_if(keys, [](std::string_view key) { return key == "images" || key == "mask"; });
  return keys;
}

void require_in_image(const std::vector<std::array<double, 2>>& curve_pixels, Size size, const std::string& where) {
  for (const auto& [x, y] : curve_pixels) {
    if (x >= 0 && y >= 0 && x < size.width && y < size.height) continue;
    std::ostringstream message;
    message << where << " [" << x << ", " << y << "]: expected pixels within the polarized image of " << to_string(size)
            << " pixels";
    throw input_error(message.str());
  }
}

/// Reads [[patch]] and [[profile]], and checks that [polarized].curve_pixels lie in the image.
void read_regions(const TomlTable& document, Size size, StationFile& station) {
  require_in_image(station.polarized.curve_pixels, size, document.where("[polarized].curve_pixels"));
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
  const auto polarized = document.required(document.section("polarized", polarized_keys(given)), "polarized",
                                           "the section [polarized] with the images taken through the polarizer");
  station.polarized = read_polarized(polarized, given);
  if (const auto table = document.section("optics", {"refractive_index", "reflection", "light", "metal"}))
    station.optics = read_optics(*table, given);
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
    images = size_of_images(station, polarized.where("images"));
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

StationFile with_curve_pixels(StationFile station, std::vector<std::array<double, 2>> pixels) {
  if (pixels.size() > most_curve_pixels)
    throw input_error("pixels: " + std::to_string(pixels.size()) + ", expected at most " +
                      std::to_string(most_curve_pixels));
  const std::optional<Size> images = size_of_images(station, "[polarized].images");
  require_in_image(pixels, images ? *images : size_of_camera(station), "pixel");
  station.polarized.curve_pixels = std::move(pixels);
  return station;
}

}  // namespace malus
