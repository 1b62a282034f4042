#include <cmath>
#include <utility>

#include "malus/core/depth_normals_internal.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/spread_pixels_internal.h"
#include "malus/evidence/before_fusion_internal.h"
#include "malus/evidence/contrast_check_internal.h"
#include "malus/evidence/object_size_internal.h"

namespace malus {
namespace {

/// Evenly sampled points of the prior on the object, to its outermost rows and columns: they determine its size.
std::vector<Eigen::Vector3d> points_of(const Image<float>& depth, const Mask& object, const Pinhole& camera) {
  constexpr double most_points = 100000;
  constexpr double fewest_points = 2000;  // of a small object in a large image, or all of them
  std::vector<Eigen::Vector3d> points;
  const int stride = stride_on(object, depth.size(), most_points, fewest_points);
  for_each_spread(bounding_box(object), stride, [&](int u, int v) {
    if (object(u, v) != 0 && std::isfinite(depth(u, v))) points.push_back(depth(u, v) * camera.ray(u, v));
  });
  return points;
}

}  // namespace

std::vector<Finding> findings_before_fusion(const BeforeFusion& input, const Context& context) {
  const AlignmentScene& images = input.images;
  require_size(input.prior_depth, images.state.size(), "depth map of the prior");
  std::vector<Finding> findings;
  const std::vector<Eigen::Vector3d> points = points_of(input.prior_depth, images.object, images.camera);
  if (!points.empty()) findings.push_back(object_size(points, images.camera, images.unit).finding);
  const Image<float> normals = normals_from_depth(input.prior_depth, images.camera, context);
  PhaseAgreement phase = phase_agreement(images.state, &images.camera, normals, context);
  const PriorAlignment place = input.cloud != nullptr ? check_alignment(*input.cloud, input.pose, images, context)
                                                      : check_alignment(input.prior_depth, images, context);
  const bool is_interpolated = place.object_covered < PriorAlignment::poorly_covered;
  // The interpolated surface may be wrong instead of the polarization. But wrong slopes cannot interpret the
  // polarization either, so a caution remains.
  if (is_interpolated && phase.is_unrelated) {
    phase.finding.severity = Severity::caution;
    phase.finding.message += "; the prior is interpolated on most of the object";
  } else if (is_interpolated && phase.finding.severity != Severity::note) {
    phase.finding.severity = Severity::note;
    phase.finding.message =
        "whether the polarization fits the prior could not be checked: the prior is interpolated on most of the object";
    phase.finding.suggestion.clear();
  }
  findings.push_back(std::move(phase.finding));
  findings.push_back(place.finding);
  findings.push_back(check_contrast(place.color, input.response, input.known_linear));
  return findings;
}

}  // namespace malus
