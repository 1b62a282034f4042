#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <sstream>

#include "malus/io/curve_pixels_internal.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/input_file_internal.h"
#include "malus/io/polarized_files_internal.h"
#include "malus/io/section_reading_internal.h"
#include "malus/io/station_sections_internal.h"

namespace malus {
namespace {

// Angles closer than this on the circle of 180° count as one.
constexpr double distinct_angle_deg = 1e-3;
// Angles that all lie within this on the circle of 180° cannot be meant: one turn in radians is less.
constexpr double least_sector_deg = 6.3;

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
    if (images.empty())
      throw table.wrong("images", "a folder with PNG, TIFF, JPEG or RAW files, or a pattern that matches files");
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

/// The response, with the absolute path of a lookup table.
Response read_response(const TomlTable& table) {
  const auto response = Response::of(table.text("response").value_or("linear"));
  if (!response) throw table.wrong("response", "\"gamma:\" and a number from 0.1 to 10");
  if (!response->table()) return *response;
  const auto path = table.resolve("response", response->text());
  if (!std::filesystem::exists(path))
    throw table.wrong("response", "\"linear\", \"srgb\", \"gamma:2.2\" or the file of a lookup table");
  require_file(path, table.where("response"));
  return *Response::of(std::filesystem::absolute(path).string());
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

/// Names of images in memory, for messages.
std::vector<std::filesystem::path> names_of_images(std::size_t count) {
  std::vector<std::filesystem::path> names;
  for (std::size_t k = 0; k < count; ++k) names.emplace_back("images[" + std::to_string(k) + "]");
  return names;
}

/// Keys of [polarized]; without the keys of files if the images are in memory.
Keys polarized_keys(const GivenInMemory* given) {
  if (given == nullptr) return keys_of(PolarizedSpec{}, {"angle_pattern"});
  Keys keys = keys_of(PolarizedSpec{});
  std::erase_if(keys, [](std::string_view key) { return key == "images" || key == "mask"; });
  return keys;
}

}  // namespace

PolarizedSpec read_polarized(const TomlTable& document, const GivenInMemory* given) {
  const auto table = document.required(document.section("polarized", polarized_keys(given)), "polarized",
                                       "the section [polarized] with the images taken through the polarizer");
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
    spec.mosaic_colors = table.choice<BayerPattern>("mosaic_colors");
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

  spec.curve_pixels = read_curve_pixels(table);
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

}  // namespace malus
