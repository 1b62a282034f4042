#include "malus/fusion/surface_estimate_internal.h"

namespace malus {

Eigen::Vector2d central_gradient(const SurfaceEstimate& surface, int u, int v) {
  const double centre = surface.x(u, v);
  const auto along = [&](int du, int dv) {
    double sum = 0;
    int count = 0;
    for (const int side : {-1, 1}) {
      if (!surface.is_object(u + side * du, v + side * dv)) continue;
      sum += side * (surface.x(u + side * du, v + side * dv) - centre);
      ++count;
    }
    return count == 0 ? 0.0 : sum / count;
  };
  return {along(1, 0), along(0, 1)};
}

Eigen::Vector2d central_slopes(const SurfaceEstimate& surface, int u, int v) {
  const RaySlopes slopes = surface.slopes_at(u, v);
  const Eigen::Vector2d gradient = central_gradient(surface, u, v);
  return {slopes.p(gradient[0], gradient[1]), slopes.q(gradient[0], gradient[1])};
}

}  // namespace malus
