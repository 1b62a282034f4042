#include "malus/station/control_points_internal.h"
#include "malus/station/json_fields_internal.h"
#include "malus/station/prior_scale_internal.h"
#include "malus/station/quality_json_internal.h"

namespace malus {

Json refine_report_json(const RefineReport& report) {
  const ReflectionModel& model = report.reflection;
  // Only one of the two reflection models was used; fits of the other one do not belong to the result.
  Json light, lobe, environment, mirror, surroundings, metal;
  const Image<float>& radiance = report.surroundings.radiance;
  if (radiance.empty()) {
    light = {{"direction", {model.lobe.light.x(), model.lobe.light.y(), model.lobe.light.z()}},
             {"sigma_rad", fields_to_json(report.light_sigma_rad)}};
    lobe = {{"strength", model.lobe.strength},
            {"strength_sigma", fields_to_json(report.lobe_strength_sigma)},
            {"roughness", model.lobe.roughness},
            {"roughness_sigma", fields_to_json(report.lobe_roughness_sigma)}};
    for (std::size_t k = 0; k < model.environment.radiance.size(); ++k) {
      environment.push_back({{"zenith_rad", EnvironmentProfile::nodes_rad[k]},
                             {"radiance", model.environment.radiance[k]},
                             {"sigma", fields_to_json(report.environment_sigma[k])}});
    }
    mirror = {{"body", model.mirror.body},
              {"body_sigma", fields_to_json(report.mirror_body_sigma)},
              {"environment", model.mirror.environment},
              {"environment_sigma", fields_to_json(report.mirror_environment_sigma)}};
  } else {
    Json rows = Json::array();
    for (int row = 0; row < radiance.height(); ++row)
      rows.push_back(std::vector<float>(radiance.row(row), radiance.row(row) + radiance.width()));
    surroundings = {{"roughness", report.surroundings.finishes.usual},
                    {"other_roughness", report.surroundings.finishes.other},
                    {"other_finish_share", report.other_finish_share},
                    {"self_mirroring_share", report.self_mirroring_share},
                    {"radiance", rows}};
    if (report.metal_index != 0.0)
      metal = {{"refractive_index", {report.metal_index.real(), report.metal_index.imag()}},
               {"intensity_error", model.metal_error},
               {"stated", fields_to_json(report.stated_metal)}};
  }
  Json json = {{"refractive_index",
                {{"value", model.eta},
                 {"sigma", fields_to_json(report.eta_sigma)},
                 {"stated", fields_to_json(report.stated_eta)}}},
               {"light", light},
               {"lobe", lobe},
               {"environment", environment},
               {"surroundings", surroundings},
               {"metal", metal},
               {"mirror", mirror}};
  json.update(fields_to_json(report));
  return json;
}

Json quality_json(const StationFile& station, const Quality& quality, const PolarizerCalibration& polarizer,
                  const ClampedZeniths* clamped, const RefinementFindings* refinement,
                  const Photogrammetry* photogrammetry) {
  Json json = {{"name", station.name}, {"object", fields_to_json(station.object)}};
  if (photogrammetry != nullptr) json.update(Json::parse(photogrammetry->figures_json));
  json.update(fields_to_json(quality));
  if (!station.control.empty() || json.contains("control")) {
    Json& control = json["control"];
    if (!control.contains("datum")) control["datum"] = nullptr;
    control["image"] = control_json(station);
  }
  if (const Json scale = scale_json(station); !scale.is_null()) json["prior_scale"] = scale;
  json["polarizer"] = fields_to_json(polarizer);
  json["zenith_clamped_fraction"] = clamped != nullptr ? Json(clamped->fraction) : Json(nullptr);
  if (refinement != nullptr) json["refinement"] = Json::parse(refinement->report_json);
  return json;
}

}  // namespace malus
