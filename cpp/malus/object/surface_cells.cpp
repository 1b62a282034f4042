#include <algorithm>

#include "malus/object/surface_cells_internal.h"
#include "malus/object/view_lookup_internal.h"

namespace malus {
namespace {

/// Standard deviations (GSD) of a pixel's move across the surface: the surface's own one, clipped to these, before it
/// is multiplied by the length over which errors are shared.
constexpr double least_place_gsd = 0.2, most_place_gsd = 1.0;
/// Pixels farther apart in depth (GSD) do not belong to one surface.
constexpr double most_cell_step_gsd = 6.0;

}  // namespace

bool is_cell(const ObjectView& view, int u, int v) {
  if (u + 1 >= view.camera.size.width || v + 1 >= view.camera.size.height) return false;
  double least = view.depth(u, v), most = least;
  for (const CellCorner& corner : cell_corners) {
    if (view.usable(u + corner.du, v + corner.dv) == 0) return false;
    const double depth = view.depth(u + corner.du, v + corner.dv);
    least = std::min(least, depth);
    most = std::max(most, depth);
  }
  return most - least < most_cell_step_gsd * view.gsd;
}

Eigen::Vector3d from_eye(const ObjectView& view, int u, int v) {
  return point_at(view, u, v) - view.pose.center();
}

SurfaceCells::SurfaceCells(const ObjectView& view, const PixelRect& window) : view_(&view) {
  Mask begins(window.size()), belongs(window.size());
  // Cells do not reach beyond the window.
  for_each_pixel(PixelRect{0, 0, window.width() - 1, window.height() - 1}, [&](int u, int v) {
    if (!is_cell(view, window.u0 + u, window.v0 + v)) return;
    begins(u, v) = 1;
    for (const CellCorner& corner : cell_corners) belongs(u + corner.du, v + corner.dv) = 1;
  });
  pixels_ = PixelIndex(belongs);
  for (int i = 0; i < pixels_.count(); ++i) {
    const int u = window.u0 + pixels_.u(i), v = window.v0 + pixels_.v(i);
    begins_cell_.push_back(begins(pixels_.u(i), pixels_.v(i)));
    from_eye_.push_back(from_eye(view, u, v));
    sigma_.push_back(view.shared_px * std::clamp(view.sigma(u, v) / view.gsd, least_place_gsd, most_place_gsd));
    across_.push_back(from_eye_.back().norm() * view.cosine(u, v) / view.gsd);
  }
}

std::array<int, 4> SurfaceCells::corner_unknowns(int unknown) const {
  const int u = pixels_.u(unknown), v = pixels_.v(unknown);
  return {unknown, pixels_.at(u + 1, v), pixels_.at(u, v + 1), pixels_.at(u + 1, v + 1)};
}

CellPoints SurfaceCells::corners(const std::array<int, 4>& unknowns, const Eigen::VectorXd& growth) const {
  CellPoints points;
  for (std::size_t k = 0; k < points.size(); ++k) {
    points[k] = (1 + growth[unknowns[k]]) * from_eye_[static_cast<std::size_t>(unknowns[k])];
  }
  return points;
}

}  // namespace malus
