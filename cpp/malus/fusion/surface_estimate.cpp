#include "malus/fusion/surface_estimate_internal.h"
#include "malus/polarization/slopes_of_depth_internal.h"

namespace malus {

Mask nodes_of(const Mask& pixels) {
  Mask nodes(pixels.size());
  for_each_pixel(PixelRect{0, 0, pixels.width() - 1, pixels.height() - 1}, pixels,
                 [&](int u, int v) { nodes(u, v) = nodes(u + 1, v) = nodes(u, v + 1) = nodes(u + 1, v + 1) = 255; });
  return nodes;
}

Eigen::Vector2d central_gradient(const SurfaceEstimate& surface, const Image<double>& x, int u, int v) {
  const auto along = [&](int du, int dv) {
    double sum = 0;
    int count = 0;
    for (const int side : {0, 1}) {
      const int u0 = u + side * dv, v0 = v + side * du;
      if (!surface.is_object(u0, v0) || !surface.is_object(u0 + du, v0 + dv)) continue;
      sum += x(u0 + du, v0 + dv) - x(u0, v0);
      ++count;
    }
    return count == 0 ? 0.0 : sum / count;
  };
  return {along(1, 0), along(0, 1)};
}

Slopes central_slopes(const SurfaceEstimate& surface, int u, int v) {
  return central_slopes(surface, surface.x, u, v);
}

Slopes central_slopes(const SurfaceEstimate& surface, const Image<double>& x, int u, int v) {
  const Eigen::Vector2d gradient = central_gradient(surface, x, u, v);
  const Pinhole& camera = surface.camera;
  const AffineSlopes slopes = slopes_of_log_depth(camera, surface.frame_at(u, v), u, v, camera.focal());
  return slopes(gradient[0], gradient[1]);
}

}  // namespace malus
