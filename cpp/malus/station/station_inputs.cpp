#include <string_view>

#include "malus/io/colmap_workspace.h"
#include "malus/io/sha256.h"
#include "malus/station/station_inputs_internal.h"

namespace malus {
namespace {

template <class T>
Json optional_value(const std::optional<T>& value) {
  return value ? Json(*value) : Json(nullptr);
}

Json lens_to_json(const LensCamera& lens) {
  return {{"model", to_string(lens.model)},
          {"width", lens.size.width},
          {"height", lens.size.height},
          {"params", lens.params}};
}

}  // namespace

Json StationInputs::file(const std::filesystem::path& path) {
  const std::filesystem::path relative = path.lexically_proximate(station_.file.path.parent_path());
  const std::string name = relative.string();
  auto found = hashes_.find(name);
  if (found == hashes_.end()) {
    context_.check_cancel();
    found = hashes_.emplace(name, sha256_of_file(path, "input")).first;
  }
  return {{"path", name}, {"sha256", found->second}};
}

template <class T>
Json StationInputs::array(const T* data, std::size_t count) {
  return sha256_of_bytes(std::string_view(reinterpret_cast<const char*>(data), count * sizeof(T)));
}

Json StationInputs::polarized() {
  const PolarizedSpec& spec = station_.file.polarized;
  Json json = {{"angles_deg", optional_value(spec.angles_deg)},
               {"angle_direction", spec.angle_direction},
               {"angle_zero_deg", spec.angle_zero_deg},
               {"mosaic", optional_value(spec.mosaic)},
               {"mosaic_colors", optional_value(spec.mosaic_colors)},
               {"exposure_s", optional_value(spec.exposure_s)},
               {"channel", spec.channel},
               {"channel_weights", optional_value(spec.channel_weights)},
               {"response", spec.response},
               {"white_level", optional_value(spec.white_level)},
               {"black_level", spec.black_level},
               {"frames_averaged", spec.frames_averaged},
               {"full_well_e", optional_value(spec.full_well_e)},
               {"read_noise_e", optional_value(spec.read_noise_e)},
               {"images", Json::array()}};
  for (const auto& path : spec.images) json["images"].push_back(file(path));
  for (const auto& image : station_.images) json["images"].push_back(array(image.data(), image.count()));
  if (std::filesystem::is_regular_file(spec.response)) json["response_table"] = file(spec.response);
  if (spec.mask) json["mask"] = file(*spec.mask);
  if (station_.mask) json["mask"] = array(station_.mask->data(), station_.mask->count());
  return json;
}

Json StationInputs::optics() {
  const OpticsSpec& spec = station_.file.optics;
  Json json = {{"refractive_index", optional_value(spec.refractive_index)}, {"reflection", spec.reflection}};
  if (spec.label_image) json["labels"] = file(*spec.label_image);
  return json;
}

Json StationInputs::lens() {
  if (station_.file.camera) return lens_to_json(station_.file.camera->lens);
  return station_.file.lens ? lens_to_json(*station_.file.lens) : Json(nullptr);
}

Json StationInputs::camera() {
  Json json = {{"lens", lens()}};
  if (const auto& camera = station_.file.camera) {
    json["pose"] = std::vector<double>(camera->pose.rotation.data(), camera->pose.rotation.data() + 9);
    json["translation"] = std::vector<double>(camera->pose.translation.data(), camera->pose.translation.data() + 3);
  }
  return json;
}

Json StationInputs::prior() {
  Json json = Json::object();
  if (const auto& spec = station_.file.prior) {
    if (spec->cloud && std::filesystem::is_directory(*spec->cloud)) {
      json["cloud"] = Json::array();
      for (const auto& path : colmap_workspace_files(*spec->cloud)) json["cloud"].push_back(file(path));
    } else if (spec->cloud) {
      json["cloud"] = file(*spec->cloud);
    }
    if (spec->mesh) json["mesh"] = file(*spec->mesh);
    if (spec->depth) json["depth"] = file(*spec->depth);
  }
  if (station_.cloud) json["cloud"] = array(station_.cloud->points.data(), station_.cloud->points.size());
  if (station_.prior_depth) json["depth"] = array(station_.prior_depth->data(), station_.prior_depth->count());
  if (const auto& swept = station_.swept) {
    json["swept"] = array(swept->depth.data(), swept->depth.count());
    json["sigma"] = array(swept->sigma.data(), swept->sigma.count());
    json["shape"] = array(swept->shape.data(), swept->shape.count());
  }
  return json;
}

Json StationInputs::regions() {
  Json json = Json::array();
  for (const PatchSpec& patch : station_.file.patches)
    json.push_back({patch.name, patch.x0, patch.y0, patch.x1, patch.y1});
  for (const ProfileSpec& profile : station_.file.profiles) json.push_back({profile.name, profile.from, profile.to});
  return json;
}

}  // namespace malus
