#include <optional>

#include "malus/assess/quality_internal.h"
#include "malus/io/point_cloud_file_internal.h"
#include "malus/station/quality_json_internal.h"
#include "malus/station/step_functions_internal.h"

namespace malus {

QualityReport make_quality(const Job& job, const FusedSurface& surface, const CalibratedPolarization& polarization,
                           const StationView& view, const DepthPrior& prior, const ClampedZeniths* clamped,
                           const HeightMap* height, const RefinementFindings* refinement, const Warnings& warnings) {
  const StationFile& station = job.station.file;
  std::optional<TriangleMesh> reference;
  if (job.run.reference) reference = read_cloud_or_mesh(*job.run.reference, job.context);
  Quality quality = assess({.surface = &surface,
                            .prior = &prior,
                            .height = height,
                            .polarization = polarization.state.get(),
                            .reference = reference ? &*reference : nullptr,
                            .registration_rms_px = view.registration_rms_px,
                            .patches = station.patches,
                            .profiles = station.profiles,
                            .unit = station.unit},
                           job.options.assess, job.context);
  quality.warnings = warnings.all;
  const auto& photogrammetry = job.station.photogrammetry;
  const Json json = quality_json(station, quality, polarization.polarizer, clamped, refinement,
                                 photogrammetry ? &*photogrammetry : nullptr);
  return {.json = json.dump(2) + "\n",
          .status = quality.status,
          .confidence = quality.confidence,
          .distance = quality.reference ? std::move(quality.reference->distance) : Image<float>()};
}

}  // namespace malus
