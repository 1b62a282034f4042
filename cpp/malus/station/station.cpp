#include "malus/station/station.h"

#include "malus/io/colmap_workspace_internal.h"
#include "malus/io/station_file_internal.h"
#include "malus/station/control_points_internal.h"
#include "malus/station/json_fields_internal.h"
#include "malus/station/prior_scale_internal.h"

namespace malus {
namespace {

/// The kind of prior, and its file.
Json describe_prior(const Station& station) {
  struct Source {
    const Station& station;

    Json operator()(std::monostate) const { return {{"prior", station.file.photos ? "photos" : "none"}}; }
    Json operator()(const CloudFile& file) const { return {{"prior", "cloud"}, {"prior_cloud", file.path.string()}}; }
    Json operator()(const MeshFile& file) const { return {{"prior", "mesh"}, {"prior_mesh", file.path.string()}}; }
    Json operator()(const DepthFile& file) const { return {{"prior", "depth"}, {"prior_depth", file.path.string()}}; }
    Json operator()(const Shape& shape) const {
      const std::string name(name_of(shape));
      return {{"prior", name},
              {"prior_" + name, std::visit([](const auto& some) { return fields_to_json(some); }, shape)}};
    }
    Json operator()(const PointCloud&) const { return {{"prior", "cloud"}}; }
    Json operator()(const TriangleMesh&) const { return {{"prior", "mesh"}}; }
    Json operator()(const Image<float>&) const { return {{"prior", "depth"}}; }
    Json operator()(const SweptDepth&) const { return {{"prior", "depth"}}; }
  };
  return std::visit(Source{station}, station.prior);
}

/// Every file that results may depend on, except the photos' folder.
std::vector<std::filesystem::path> files_of(const StationFile& file) {
  std::vector<std::filesystem::path> files = file.polarized.images;
  const auto add = [&files](const std::filesystem::path& path) { files.push_back(path); };
  if (!file.path.empty()) add(file.path);
  if (file.polarized.mask) add(*file.polarized.mask);
  if (const auto table = file.polarized.response.table()) add(*table);
  if (file.optics.label_image) add(*file.optics.label_image);
  for (const auto& path : file.camera_files) add(path);
  const auto add_prior = [&add](const auto& source) {
    if constexpr (requires { source.path; }) {  // a shape has no file
      if (!std::filesystem::is_directory(source.path)) return add(source.path);
      for (const auto& path : colmap_workspace_files(source.path)) add(path);
    }
  };
  if (file.prior) std::visit(add_prior, *file.prior);
  return files;
}

}  // namespace

Station Station::load(const std::filesystem::path& path, const std::optional<std::filesystem::path>& photos_of) {
  Station station;
  station.file = read_station_file(path, photos_of);
  if (station.file.prior) std::visit([&](const auto& file) { station.prior = file; }, *station.file.prior);
  return station;
}

std::string describe_station_json(const Station& station) {
  const StationFile& file = station.file;
  Json json = {{"name", file.name},
               {"unit", file.unit},
               {"object", fields_to_json(file.object)},
               {"image_count", station.in_memory() ? station.images.size() : file.polarized.images.size()}};
  json.update(fields_to_json(file.polarized));
  json.update(fields_to_json(file.optics));
  json.update(describe_prior(station));
  if (file.prior_sigma) json["prior_sigma"] = *file.prior_sigma;
  json["prior_scale"] = file.prior_scale;
  if (!file.path.empty()) json["path"] = file.path.string();
  json["files"] = fields_to_json(files_of(file));
  if (file.camera) {
    json["camera"] = fields_to_json(file.camera->lens);
    json["camera"].update(fields_to_json(file.camera->pose));
  } else if (file.lens) {
    json["camera"] = fields_to_json(*file.lens);
  }
  if (file.camera_image) json["camera_image"] = *file.camera_image;
  if (file.photos) json["photos"] = fields_to_json(*file.photos);
  json["scale"] = fields_to_json(file.scale_bars);
  json["control"] = fields_to_json(file.control);
  json["control_image"] = control_json(file);
  json["patches"] = fields_to_json(file.patches);
  json["profiles"] = fields_to_json(file.profiles);
  return json.dump();
}

std::vector<std::string> station_warnings(const Station& station) {
  std::vector<std::string> warnings = scale_warnings(station.file);
  if (station.file.has_unused_pose)
    warnings.emplace_back("the pose in [camera] is not used: the station is placed among the [photos]");
  // The camera from a model of photos is in the control points' frame only after the photogrammetry.
  if (station.file.frame_is_of_photos() && !station.photogrammetry) return warnings;
  for (std::string& warning : control_warnings(station.file)) warnings.push_back(std::move(warning));
  return warnings;
}

}  // namespace malus
