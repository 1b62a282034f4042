#include "malus/io/colmap_model_internal.h"
#include "malus/station/kept_results_internal.h"

namespace malus {
namespace {

/// The parts of the state that change when the surface corrects the polarizer's scale; the others stay as measured.
void keep_maps(PolarizationState& state, const std::string& folder, Keeper& keeper) {
  keeper.raster(folder + "unpolarized.tif", state.i_un);
  keeper.raster(folder + "degree.tif", state.rho);
  keeper.raster(folder + "phase.tif", state.phi);
  keeper.value("angles_rad", state.angles_rad);
}

}  // namespace

void keep(MeasuredPolarization& result, Keeper& keeper) {
  PolarizationState& state = keeper.shared(result.state);
  keep_maps(state, "polarization/measured/", keeper);
  keeper.raster("polarization/valid.png", state.valid);
  keeper.raster("polarization/residual.tif", state.residual);
  keeper.raster("polarization/variance_factor.tif", state.variance_factor);
  keeper.value("exposures", state.exposures);
  keeper.value("noise", state.noise);
  keeper.value("weighting", state.weighting);
  keeper.value("polarizer", result.polarizer);
  keeper.value("polarizer_fitted", result.polarizer_fitted);
  keeper.value("curves", result.curves);
}

void keep(StationView& result, Keeper& keeper) {
  keeper.fields(result);
}

void keep(ImageFindings& result, Keeper& keeper) {
  keeper.value("findings", result.findings);
}

void keep(ObjectColor& result, Keeper& keeper) {
  keeper.raster("polarization/color.tif", result.image);
}

void keep(Scene& result, Keeper& keeper) {
  keeper.raster("polarization/scene.tif", result.image);
}

void keep(CalibratedPolarization& result, Keeper& keeper) {
  keeper.value("calibration", result.polarizer);
  if (!keeper.is_reading()) return keep_maps(keeper.shared(result.state), "polarization/", keeper);
  const auto measured = keeper.result<MeasuredPolarization>();
  result.state = measured->state;
  if (!result.polarizer.from_surface) return;
  PolarizationState& state = keeper.shared(result.state);
  state = *measured->state;
  keep_maps(state, "polarization/", keeper);
}

void keep(DepthPrior& result, Keeper& keeper) {
  keeper.raster("prior/depth.tif", result.depth);
  keeper.raster("prior/sigma.tif", result.sigma);
  keeper.fields(result);
}

void keep(PriorPoints& result, Keeper& keeper) {
  keeper.raster("prior/points.png", result.map);
}

void keep(InputEvidence& result, Keeper& keeper) {
  std::string json = fields_to_json(result.findings).dump(2) + "\n";
  keeper.text("evidence/findings.json", json);
  if (keeper.is_reading()) fields_from_json(result.findings, Json::parse(json));
}

void keep(ReflectionMap& result, Keeper& keeper) {
  keeper.raster("polarization/zenith.tif", result.zenith);
  keeper.raster("polarization/label.png", result.label);
  keeper.value("refractive_index", result.refractive_index);
  keeper.value("specular_share", result.specular_share);
  keeper.value("clamped_share", result.clamped_share);
}

void keep(ClampedZeniths& result, Keeper& keeper) {
  keeper.raster("polarization/clamped.png", result.map);
  keeper.value("clamped_fraction", result.fraction);
}

void keep(HeightMap& result, Keeper& keeper) {
  keeper.raster("height/height.tif", result.height);
  keeper.fields(result);
}

void keep(FusedSurface& result, Keeper& keeper) {
  keeper.raster("fused/depth.tif", result.depth);
  keeper.raster("fused/normals.tif", result.normals);
  keeper.raster("fused/sigma.tif", result.sigma);
  keeper.extra("fused/camera.txt", colmap_text(result.camera));
  keeper.extra("fused/image.txt", colmap_text(result.pose, "depth.tif"));
  keeper.fields(result);
}

void keep(RefinementFindings& result, Keeper& keeper) {
  keeper.raster("fused/label.png", result.label);
  keeper.raster("fused/confidence.png", result.confidence);
  keeper.raster("fused/trust.png", result.trust);
  keeper.raster("fused/mirrored.tif", result.mirrored);
  keeper.text("fused/refinement.json", result.report_json);
}

void keep(QualityReport& result, Keeper& keeper) {
  keeper.text("quality.json", result.json);
  if (keeper.is_reading()) {
    const Json json = Json::parse(result.json);
    fields_from_json(result.status, json.at("status"));
    fields_from_json(result.confidence, json.at("confidence"));
  }
  keeper.raster("fused/reference_distance.tif", result.distance);
}

}  // namespace malus
