#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>
#include <utility>
#include <vector>

#include "malus/core/pixel_rect_internal.h"
#include "malus/evidence/outline_place_internal.h"

namespace malus {
namespace {

constexpr std::size_t sectors = 24;
using Sectors = std::array<double, sectors>;

constexpr double largest_move = 0.1, size_step = 0.025;
/// Distances from the outline at which depths inside and outside are compared; a step of `full_step` pixels counts
/// fully.
constexpr int inside_px = 1, outside_px = 2;
constexpr double full_step = 2;
/// Of rendered coins and medals without informative colors and phases, no small right one gains more than 1.5 standard
/// deviations; one at full size gained 2.2 by one step of the size.
constexpr double offset_sigmas = 2;
/// Least gain in the mean step: one so small that it is nothing but rounding to pixels has 4.9 standard deviations if
/// it is the same in all sectors. On simulated discs half of this more than doubles the false warnings (decision 77).
constexpr double offset_gain = 0.05;
/// Share of the extent by which a point of the outline is moved.
constexpr double offset_shift = 0.03;
/// More than one step of the size: the edge of a smoothed cloud lies that far beside the object's.
constexpr double offset_scale = 1.2 * size_step;

/// A pixel of the object with a neighbor outside the object.
struct OutlinePixel {
  double u, v;
  int right, down;  ///< outwards
  std::size_t sector;
};

struct Outline {
  std::vector<OutlinePixel> pixels;
  double center_u = 0, center_v = 0, extent = 0;
};

Outline outline_of(const Mask& object) {
  Outline outline;
  double count = 0;
  for_each_pixel(object, [&](int u, int v) {
    ++count;
    outline.center_u += u;
    outline.center_v += v;
  });
  if (count == 0) return outline;
  outline.center_u /= count;
  outline.center_v /= count;
  const PixelRect box = bounding_box(object);
  outline.extent = std::max(box.width(), box.height());
  constexpr std::array directions{std::pair(1, 0), std::pair(-1, 0), std::pair(0, 1), std::pair(0, -1)};
  for_each_pixel(PixelRect{1, 1, object.width() - 1, object.height() - 1}, object, [&](int u, int v) {
    for (const auto& [across, down] : directions) {
      if (object(u + across, v + down) != 0) continue;
      const double angle = std::atan2(v - outline.center_v, u - outline.center_u) / (2 * std::numbers::pi) + 0.5;
      const auto sector = std::min(static_cast<std::size_t>(angle * sectors), sectors - 1);
      outline.pixels.push_back({static_cast<double>(u), static_cast<double>(v), across, down, sector});
    }
  });
  return outline;
}

/// Mean outward step by sectors of the outline, as contributions that add up to the mean over the whole outline.
Sectors steps_at(const Outline& outline, const Image<float>& depth, double focal, const Similarity& moved) {
  const double shrink = std::exp(-moved.log_scale);
  const auto depth_at = [&](const OutlinePixel& pixel, int outwards) -> double {
    const double u = pixel.u + outwards * pixel.right - outline.center_u - moved.du;
    const double v = pixel.v + outwards * pixel.down - outline.center_v - moved.dv;
    const auto from_u = static_cast<int>(std::lround(outline.center_u + shrink * u));
    const auto from_v = static_cast<int>(std::lround(outline.center_v + shrink * v));
    return depth.contains(from_u, from_v) ? static_cast<double>(depth(from_u, from_v)) : 0.0;
  };
  Sectors sums{};
  for (const OutlinePixel& pixel : outline.pixels) {
    const double near = depth_at(pixel, -inside_px), far = depth_at(pixel, outside_px);
    if (!(near > 0 && far > 0)) continue;
    sums[pixel.sector] += std::clamp((far - near) / near * focal / full_step, -1.0, 1.0);
  }
  for (double& sum : sums) sum /= static_cast<double>(outline.pixels.size());
  return sums;
}

double total(const Sectors& sums) {
  return std::accumulate(sums.begin(), sums.end(), 0.0);
}

}  // namespace

bool OutlinePlace::is_offset() const {
  const double size = std::abs(place.log_scale), farthest = std::hypot(place.du, place.dv) + size * extent / 2;
  const bool is_beyond = farthest > offset_shift * extent || size > offset_scale;
  // A place at the end of the search range is no result: if the surface continues beyond the mask, as with a mask drawn
  // inside a ball's outline, the slope grows outwards, and the largest outline has the largest steps.
  const double searched = std::ceil(largest_move * extent) - 0.5;
  const bool is_peak = std::abs(place.du) < searched && std::abs(place.dv) < searched &&
                       std::abs(place.log_scale) < largest_move - 0.5 * size_step;
  return is_beyond && is_peak && at_best - as_given > offset_gain && gain_sigmas > offset_sigmas;
}

Tolerance OutlinePlace::half_step() const {
  return {0.5 / extent, 0, 0.5 * size_step};
}

OutlinePlace find_outline(const PriorView& prior, const SceneView& scene) {
  OutlinePlace found;
  const Outline outline = outline_of(scene.object);
  found.extent = outline.extent;
  if (outline.pixels.empty()) return found;
  const double focal = scene.camera.focal();
  const auto steps = [&](const Similarity& moved) { return steps_at(outline, prior.depth, focal, moved); };
  const Sectors given = steps({});
  found.as_given = found.at_best = total(given);
  const int reach = static_cast<int>(std::ceil(largest_move * outline.extent));
  const int sizes = static_cast<int>(std::lround(largest_move / size_step));
  for (int size = -sizes; size <= sizes; ++size) {
    for (int dv = -reach; dv <= reach; ++dv) {
      for (int du = -reach; du <= reach; ++du) {
        const Similarity moved{static_cast<double>(du), static_cast<double>(dv), 0, size * size_step};
        const double score = total(steps(moved));
        if (!(score > found.at_best)) continue;
        found.at_best = score;
        found.place = moved;
      }
    }
  }
  const Sectors best = steps(found.place);
  double squares = 0;
  for (std::size_t k = 0; k < sectors; ++k) squares += (best[k] - given[k]) * (best[k] - given[k]);
  if (squares > 0) found.gain_sigmas = (found.at_best - found.as_given) / std::sqrt(squares);
  return found;
}

}  // namespace malus
