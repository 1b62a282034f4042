#include "malus/station/describe.h"

#include <nlohmann/json.hpp>

namespace malus {
namespace {

using Json = nlohmann::ordered_json;

std::string prior_kind(const Station& station) {
  if (station.cloud || (station.file.prior && station.file.prior->cloud)) return "cloud";
  if (station.prior_depth || station.swept || (station.file.prior && station.file.prior->depth)) return "depth";
  if (station.file.prior && station.file.prior->mesh) return "mesh";
  return station.file.photos ? "photos" : "none";
}

}  // namespace

Json lens_to_json(const LensCamera& lens) {
  return {{"model", to_string(lens.model)},
          {"width", lens.size.width},
          {"height", lens.size.height},
          {"params", lens.params}};
}

Json pose_to_json(const Pose& pose) {
  Json rotation = Json::array();
  for (int row = 0; row < 3; ++row) {
    rotation.push_back({pose.rotation(row, 0), pose.rotation(row, 1), pose.rotation(row, 2)});
  }
  return {{"rotation", rotation}, {"translation", {pose.translation[0], pose.translation[1], pose.translation[2]}}};
}

Json marks_to_json(const std::vector<ImageMark>& marks) {
  Json json = Json::array();
  for (const ImageMark& mark : marks) json.push_back({{"image", mark.image}, {"x", mark.x}, {"y", mark.y}});
  return json;
}

Json scale_bar_to_json(const ScaleBar& bar) {
  Json json = {{"distance", bar.distance}, {"check", bar.check}};
  if (bar.targets) {
    json["targets"] = *bar.targets;
    json["targets_dictionary"] = bar.targets_dictionary;
  } else {
    json["a"] = marks_to_json(bar.a);
    json["b"] = marks_to_json(bar.b);
  }
  return json;
}

std::string describe_station_json(const Station& station) {
  const StationFile& file = station.file;
  Json images = Json::array();
  for (const auto& image : file.polarized.images) images.push_back(image.string());
  Json json = {{"name", file.name},
               {"unit", file.unit},
               {"image_count", station.in_memory() ? station.images.size() : file.polarized.images.size()},
               {"angles_deg", file.polarized.angles_deg ? Json(*file.polarized.angles_deg) : Json("auto")},
               {"images", images},
               {"exposure_s", file.polarized.exposure_s ? Json(*file.polarized.exposure_s) : Json(nullptr)},
               {"channel", file.polarized.channel},
               {"refractive_index", file.optics.refractive_index ? Json(*file.optics.refractive_index) : Json("auto")},
               {"reflection", file.optics.reflection},
               {"prior", prior_kind(station)},
               {"patches", Json::array()},
               {"profiles", Json::array()}};
  if (!file.path.empty()) json["path"] = file.path.string();
  if (file.prior && file.prior->cloud) json["prior_cloud"] = file.prior->cloud->string();
  for (const auto& path : file.polarized.images) json["polarized_files"].push_back(path.string());
  if (file.camera) {
    json["camera"] = lens_to_json(file.camera->lens);
    json["camera"].update(pose_to_json(file.camera->pose));
  } else if (file.lens) {
    json["camera"] = lens_to_json(*file.lens);
  }
  if (file.camera_image) json["camera_image"] = *file.camera_image;
  if (file.optics.label_image) json["label_image"] = file.optics.label_image->string();
  if (file.photos) {
    json["photos"] = {{"folder", file.photos->folder.string()}, {"exclude", file.photos->exclude}};
    if (file.photos->camera) json["photos"]["camera"] = lens_to_json(*file.photos->camera);
  }
  json["scale"] = Json::array();
  for (const ScaleBar& bar : file.scale_bars) json["scale"].push_back(scale_bar_to_json(bar));
  for (const PatchSpec& patch : file.patches) {
    json["patches"].push_back({{"name", patch.name}, {"box", {patch.x0, patch.y0, patch.x1, patch.y1}}});
  }
  for (const ProfileSpec& profile : file.profiles) {
    json["profiles"].push_back({{"name", profile.name}, {"from", profile.from}, {"to", profile.to}});
  }
  return json.dump();
}

}  // namespace malus
