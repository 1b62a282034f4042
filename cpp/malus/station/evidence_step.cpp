#include <algorithm>
#include <optional>
#include <utility>
#include <variant>

#include "malus/evidence/before_fusion_internal.h"
#include "malus/evidence/response_check_internal.h"
#include "malus/io/colmap_workspace_internal.h"
#include "malus/station/json_fields_internal.h"
#include "malus/station/prior_scale_internal.h"
#include "malus/station/step_functions_internal.h"

namespace malus {
namespace {

std::vector<Finding> compare_with_prior(const Job& job, const PolarizationState& state, const StationView& view,
                                        const Scene& scene, const DepthPrior& prior, const ImageFindings& of_images) {
  const double scale = job.station.file.prior_scale;
  const auto* const given = std::get_if<PointCloud>(&job.station.prior);
  std::optional<PointCloud> made;
  if (const auto* file = std::get_if<CloudFile>(&job.station.prior)) {
    made = scaled(read_cloud(file->path, job.context), scale);
  } else if (given != nullptr && scale != 1) {
    made = scaled(*given, scale);
  }
  const Mask object = state.object();
  return findings_before_fusion({.images = {state, scene.image, object, view.camera, job.station.file.unit},
                                 .pose = prior.pose,
                                 .prior_depth = prior.depth,
                                 .cloud = made ? &*made : given,
                                 .known_linear = std::ranges::any_of(of_images.findings, says_linear),
                                 .response = job.station.file.polarized.response},
                                job.context);
}

}  // namespace

void InputEvidence::limit(Confidence& confidence) const {
  for (const Finding& finding : findings) {
    if (finding.severity == Severity::note) continue;
    confidence.limit(finding.severity == Severity::caution ? ConfidenceLevel::partial : ConfidenceLevel::low,
                     finding.text());
  }
}

InputEvidence check_inputs(const Job& job, const ImageFindings& of_images, const CalibratedPolarization& polarization,
                           const StationView& view, const Scene& scene, const DepthPrior* prior) {
  InputEvidence evidence{of_images.findings};
  // Findings about images and polarizer were logged by the steps that found them.
  if (const PolarizerCalibration& scale = polarization.polarizer; !scale.doubt.empty()) {
    // Weak mirror reflections make even a correct scale look doubtful.
    const Severity severity = scale.is_contradicted ? Severity::warning : Severity::caution;
    evidence.findings.push_back(Finding{Check::scale, severity, scale.doubt, "", {}});
  }
  if (prior != nullptr) {
    for (Finding& finding : compare_with_prior(job, *polarization.state, view, scene, *prior, of_images)) {
      if (finding.severity == Severity::error && job.options.evidence.refuse)
        throw input_error(finding.text() + " (with evidence.refuse = false the run continues)");
      if (finding.severity != Severity::note) job.context.log(LogLevel::warning, finding.text());
      evidence.findings.push_back(std::move(finding));
    }
  }
  std::ranges::stable_sort(evidence.findings, std::ranges::greater(), &Finding::severity);
  return evidence;
}

}  // namespace malus
