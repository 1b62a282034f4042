#include <algorithm>
#include <array>
#include <limits>
#include <utility>
#include <vector>

#include "malus/core/median_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/evidence/mask_coverage_internal.h"

namespace malus {
namespace {

/// A mask is inverted if the prior covers less than `inverted_covers` of its white part and more than `well_covered` of
/// its black part.
constexpr double inverted_covers = 0.2, well_covered = 0.5;
/// A hole of this share of the image is too large for a scale bar or label that the mask leaves out.
constexpr double least_hole = 0.05;
/// Half the distance across the outline at which depths are compared; it allows for the uncertainty of masks and
/// priors.
constexpr int across_px = 2;
/// Least number of outline pixels with depths on both sides, and how much nearer the black side must be, in pixels.
constexpr std::size_t fewest_steps = 30;
constexpr double least_step = 0.7;

double border_share(const Mask& object) {
  const Size size = object.size();
  double border = 0;
  for (int u = 0; u < size.width; ++u) border += (object(u, 0) != 0) + (object(u, size.height - 1) != 0);
  for (int v = 0; v < size.height; ++v) border += (object(0, v) != 0) + (object(size.width - 1, v) != 0);
  return border / (2.0 * (size.width + size.height));
}

/// Depth outside minus depth inside over the depth, across every pixel of the outline.
std::vector<double> steps_across(const Image<float>& depth, const Mask& object) {
  constexpr std::array directions{std::pair(1, 0), std::pair(-1, 0), std::pair(0, 1), std::pair(0, -1)};
  std::vector<double> steps;
  const PixelRect within{across_px, across_px, object.width() - across_px, object.height() - across_px};
  for_each_pixel(within, object, [&](int u, int v) {
    for (const auto& [right, down] : directions) {
      if (object(u + right, v + down) != 0) continue;
      const float inside = depth(u - right * (across_px - 1), v - down * (across_px - 1));
      const float outside = depth(u + right * across_px, v + down * across_px);
      if (inside > 0 && outside > 0) steps.push_back((outside - inside) / inside);
    }
  });
  return steps;
}

}  // namespace

bool MaskCoverage::is_object_behind() const {
  return border > 0.5 && black > least_hole && outline_step < -least_step;
}

bool MaskCoverage::is_mask_inverted() const {
  return is_object_behind() || (object < inverted_covers && has_surroundings() && border > 0.5);
}

bool MaskCoverage::has_surroundings() const {
  return beside > well_covered;
}

MaskCoverage mask_coverage(const PriorView& prior, const SceneView& scene) {
  double object = 0, beside = 0;
  MaskCoverage covered;
  for (std::size_t i = 0; i < prior.seen.count(); ++i) {
    const bool is_object = scene.object[i] != 0, is_seen = prior.seen[i] != 0;
    (is_object ? object : beside) += 1;
    (is_object ? covered.object : covered.beside) += is_seen ? 1 : 0;
  }
  covered.object = object > 0 ? covered.object / object : std::numeric_limits<double>::quiet_NaN();
  covered.beside /= std::max(beside, 1.0);
  covered.black = beside / std::max(object + beside, 1.0);
  covered.border = border_share(scene.object);
  std::vector<double> steps = steps_across(prior.depth, scene.object);
  if (steps.size() >= fewest_steps) covered.outline_step = median_in_place(steps) * scene.camera.focal();
  return covered;
}

}  // namespace malus
