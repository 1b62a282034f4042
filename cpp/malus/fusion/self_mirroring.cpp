#include <algorithm>
#include <cmath>

#include "malus/core/even_choice_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/fusion/coarse_level_internal.h"
#include "malus/fusion/self_mirroring_internal.h"

namespace malus {
namespace {

/// Depth of the pixels' centers, NaN outside the object.
Image<double> pixel_depths(const RefinementImage& image, const Context& context) {
  Image<double> depths(image.size(), 1, no_value);
  parallel_pixels(context, image.pixels, [&](int u, int v) {
    depths(u, v) = image.depth_of((image.x(u, v) + image.x(u + 1, v) + image.x(u, v + 1) + image.x(u + 1, v + 1)) / 4);
  });
  return depths;
}

/// Whether the light that pixel (u, v) mirrors towards the camera comes from the surface with these depths. `side` is
/// the object's [px].
bool mirrors_itself(const RefinementImage& image, const Image<double>& depths, double side, int u, int v) {
  // The first four are lengths in GSD; `growth` is relative to `way`, `farthest` and `thickness` to the object's side.
  constexpr double start = 1.5, step = 0.8, lift = 0.5, clear = 0.3;
  constexpr double growth = 0.03, farthest = 2, thickness = 0.35;
  const Pinhole& camera = image.camera;
  const Slopes slopes = central_slopes(image, u, v);
  const RayFrame frame = image.frame_at(u, v);
  const Eigen::Vector3d normal = frame.normal(slopes);
  const Eigen::Vector3d light = 2 * normal.dot(frame.view) * normal - frame.view;
  const double gsd = depths(u, v) / camera.focal();
  const Eigen::Vector3d origin = camera.ray(u, v) * depths(u, v) + lift * gsd * normal;
  for (double way = start; way < farthest * side; way += std::max(step, growth * way)) {
    const Eigen::Vector3d at = origin + way * gsd * light;
    if (at.z() <= 0) return false;
    const Eigen::Vector2d pixel = camera.project(at);
    const int column = static_cast<int>(std::lround(pixel[0])), row = static_cast<int>(std::lround(pixel[1]));
    if (!depths.contains(column, row)) return false;
    const double behind = (at.z() - depths(column, row)) / gsd;  // NaN where no surface is in the way
    if (behind > clear && behind < thickness * side) return true;
  }
  return false;
}

}  // namespace

Mask self_mirroring_pixels(const RefinementImage& image, const Context& context) {
  constexpr int fine_enough_px = 300;
  Mask pixels(image.size());
  const PixelRect object = bounding_box(image.pixels);
  if (std::max(image.size().width, image.size().height) >= 2 * fine_enough_px &&
      std::max(object.width(), object.height()) >= fine_enough_px) {
    const Mask coarse = self_mirroring_pixels(coarsened(image, context), context);
    parallel_pixels(context, image.pixels, [&](int u, int v) { pixels(u, v) = coarse(u / 2, v / 2); });
    return pixels;
  }
  const Image<double> depths = pixel_depths(image, context);
  const double side = side_of_set(image.pixels);
  parallel_pixels(context, pixels.size(), [&](int u, int v) {
    if (image.pixels(u, v) && mirrors_itself(image, depths, side, u, v)) pixels(u, v) = 255;
  });
  return pixels;
}

}  // namespace malus
