#include "malus/core/length_unit_internal.h"
#include "malus/io/curve_pixels_internal.h"
#include "malus/io/section_reading_internal.h"
#include "malus/io/station_file_internal.h"
#include "malus/io/station_sections_internal.h"
#include "malus/io/toml_document_internal.h"
#include "malus/io/toml_table_internal.h"

namespace malus {
namespace {

std::string read_unit(const TomlTable& table, const std::string& otherwise) {
  Keys names;
  for (const LengthUnit& unit : length_units) names.push_back(unit.name);
  return table.text_among("unit", names).value_or(otherwise);
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
  read_prior(document, prior_in_memory, station);
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
  read_scale_bars(document, has_prior, station);

  if (given != nullptr) station.polarized.images.clear();
  if (!station.control.empty() && !station.camera && !station.frame_is_of_photos())
    throw document.error("control", "needs [camera] with the lens (model, width, height, params), whose pose it gives");
  const Size size = images ? *images : size_of_camera(station);
  require_control_in_image(document, station, size);
  require_curve_pixels_in_image(station.polarized.curve_pixels, size, document.where("[polarized].curve_pixels"));
  read_regions(document, size, station);
  return station;
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
  read_scale_bars(document, false, station);
  return station;
}

}  // namespace malus
