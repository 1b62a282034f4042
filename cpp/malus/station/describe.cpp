#include "malus/station/describe.h"

#include <nlohmann/json.hpp>

namespace malus {
namespace {

using Json = nlohmann::ordered_json;

std::string prior_kind(const Station& station) {
  if (station.cloud || (station.file.prior && station.file.prior->cloud)) return "cloud";
  if (station.prior_depth || (station.file.prior && station.file.prior->depth)) return "depth";
  if (station.file.prior && station.file.prior->mesh) return "mesh";
  return station.file.photos ? "photos" : "none";
}

}  // namespace

std::string describe_station_json(const Station& station) {
  const StationFile& file = station.file;
  Json json = {{"name", file.name},
               {"unit", file.unit},
               {"image_count", station.in_memory() ? station.images.size() : file.polarized.images.size()},
               {"angles_deg", file.polarized.angles_deg ? Json(*file.polarized.angles_deg) : Json("auto")},
               {"refractive_index", file.optics.refractive_index ? Json(*file.optics.refractive_index) : Json("auto")},
               {"reflection", file.optics.reflection},
               {"prior", prior_kind(station)},
               {"patches", Json::array()},
               {"profiles", Json::array()}};
  if (file.camera) {
    const LensCamera& lens = file.camera->lens;
    json["camera"] = {{"model", to_string(lens.model)},
                      {"width", lens.size.width},
                      {"height", lens.size.height},
                      {"params", lens.params}};
  }
  for (const PatchSpec& patch : file.patches) {
    json["patches"].push_back({{"name", patch.name}, {"box", {patch.x0, patch.y0, patch.x1, patch.y1}}});
  }
  for (const ProfileSpec& profile : file.profiles) {
    json["profiles"].push_back({{"name", profile.name}, {"from", profile.from}, {"to", profile.to}});
  }
  return json.dump();
}

}  // namespace malus
