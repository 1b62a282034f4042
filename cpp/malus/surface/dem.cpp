#include "malus/surface/dem.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <iterator>
#include <limits>
#include <vector>

#include "malus/core/median.h"
#include "malus/core/parallel.h"
#include "malus/surface/plane.h"

namespace malus {
namespace {

constexpr std::size_t grain = 1 << 14;
constexpr float below_everything = -std::numeric_limits<float>::infinity();

double median_gsd(const FusedSurface& surface) {
  std::vector<float> depths;
  std::copy_if(surface.depth.begin(), surface.depth.end(), std::back_inserter(depths),
               [](float z) { return std::isfinite(z) && z > 0; });
  return median_in_place(depths) / surface.camera.focal();
}

/// Robust plane through up to a million evenly spread vertices, which fix it far better than a pixel.
Plane object_plane(const std::vector<Eigen::Vector3d>& points, const Eigen::Vector3d& viewpoint,
                   const Context& context) {
  const std::size_t stride = points.size() / 1000003 + 1;
  std::vector<Eigen::Vector3d> spread;
  for (std::size_t i = 0; i < points.size(); i += stride) spread.push_back(points[i]);
  return fit_plane(spread, viewpoint, PlaneWeights::robust, context).plane;
}

/// Axes of the raster; its origin is still the plane's centroid.
Dem plane_frame(const Plane& plane, const Pose& pose) {
  Dem dem;
  dem.normal = plane.normal;
  const Eigen::Vector3d camera_x = pose.rotation.row(0);
  const Eigen::Vector3d in_plane = camera_x - camera_x.dot(plane.normal) * plane.normal;
  if (in_plane.norm() < 1e-3)
    throw data_error("the plane fitted to the object is seen edge-on; there is no elevation model");
  dem.right = in_plane.normalized();
  dem.up = dem.normal.cross(dem.right);
  dem.origin = plane.centroid;
  return dem;
}

/// Column, row and elevation of a world point.
Eigen::Vector3d raster_coordinates(const Dem& dem, const Eigen::Vector3d& x) {
  const Eigen::Vector3d offset = x - dem.origin;
  return {offset.dot(dem.right) / dem.pixel, -offset.dot(dem.up) / dem.pixel, offset.dot(dem.normal)};
}

/// Moves the origin to the top-left of the vertices and allocates the raster.
void allocate(Dem& dem, const std::vector<Eigen::Vector3d>& points) {
  Eigen::Array2d low = Eigen::Array2d::Constant(std::numeric_limits<double>::infinity()), high = -low;
  for (const Eigen::Vector3d& x : points) {
    const Eigen::Array2d position = raster_coordinates(dem, x).head<2>().array();
    low = low.min(position);
    high = high.max(position);
  }
  const Eigen::Array2d extent = (high - low).floor() + 1;
  if (!(extent.prod() <= 4e8))
    throw resource_error("the elevation model would exceed 400 million pixels; raise surface.dem_pixel");
  dem.origin = dem.world(low.x(), low.y(), 0);
  dem.elevation = Image<float>({static_cast<int>(extent.x()), static_cast<int>(extent.y())}, 1, below_everything);
}

/// Raises a pixel to this elevation. The maximum does not depend on the order, so neither does the raster on threads.
void raise(float& pixel, float elevation) {
  std::atomic_ref<float> shared(pixel);
  float present = shared.load(std::memory_order_relaxed);
  while (elevation > present && !shared.compare_exchange_weak(present, elevation, std::memory_order_relaxed)) {
  }
}

void rasterize(const std::array<Eigen::Vector3d, 3>& corner, Image<float>& elevation) {
  constexpr double tolerance = 1e-9;  // pixels on a shared edge belong to both triangles: no gaps
  const Eigen::Vector2d side_1 = (corner[1] - corner[0]).head<2>(), side_2 = (corner[2] - corner[0]).head<2>();
  const double area = side_1.x() * side_2.y() - side_1.y() * side_2.x();
  if (area == 0) return;
  const auto range = [&](int axis, int size) {
    const auto [low, high] = std::minmax({corner[0][axis], corner[1][axis], corner[2][axis]});
    return std::pair{std::max(0, static_cast<int>(std::ceil(low - tolerance))),
                     std::min(size - 1, static_cast<int>(std::floor(high + tolerance)))};
  };
  const auto [first_column, last_column] = range(0, elevation.width());
  const auto [first_row, last_row] = range(1, elevation.height());
  for (int row = first_row; row <= last_row; ++row) {
    for (int column = first_column; column <= last_column; ++column) {
      const double x = column - corner[0].x(), y = row - corner[0].y();
      const double weight_1 = (x * side_2.y() - y * side_2.x()) / area;
      const double weight_2 = (y * side_1.x() - x * side_1.y()) / area;
      if (weight_1 < -tolerance || weight_2 < -tolerance || weight_1 + weight_2 > 1 + tolerance) continue;
      const double height =
          corner[0].z() + weight_1 * (corner[1].z() - corner[0].z()) + weight_2 * (corner[2].z() - corner[0].z());
      raise(elevation(column, row), static_cast<float>(height));
    }
  }
}

}  // namespace

Dem dem_from_mesh(const TriangleMesh& mesh, const FusedSurface& surface, const SurfaceOptions& options,
                  const Context& context) {
  validate_fields(options, "surface");
  if (mesh.triangles.empty()) throw data_error("the mesh has no triangles, so there is no elevation model");
  const std::vector<Eigen::Vector3d>& points = mesh.vertices.points;
  Dem dem = plane_frame(object_plane(points, surface.pose.centre(), context), surface.pose);
  dem.pixel = options.dem_pixel ? *options.dem_pixel : median_gsd(surface) * options.subsample;
  allocate(dem, points);
  parallel_for(context, mesh.triangles.size(), grain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t t = begin; t < end; ++t) {
      const auto& [a, b, c] = mesh.triangles[t];
      rasterize(
          {raster_coordinates(dem, points[a]), raster_coordinates(dem, points[b]), raster_coordinates(dem, points[c])},
          dem.elevation);
    }
  });
  std::replace(dem.elevation.begin(), dem.elevation.end(), below_everything, std::numeric_limits<float>::quiet_NaN());
  return dem;
}

}  // namespace malus
