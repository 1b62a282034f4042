#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <sstream>
#include <vector>

#include "malus/core/digits_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/ranked_values_internal.h"
#include "malus/io/geotiff_file_internal.h"
#include "malus/surface/dem_internal.h"
#include "malus/surface/plane_internal.h"

namespace malus {
namespace {

template <class Visit>
void for_strips(const MeshInStrips& mesh, const Context& context, Visit&& visit) {
  parallel_for(context, mesh.strips, 1,
               [&](std::size_t k, std::size_t) { visit(k, mesh.strip(k, MeshInStrips::Parts::geometry)); });
}

double median_gsd(const FusedSurface& surface, const Context& context) {
  const Image<float>& depth = surface.depth;
  const auto usable = [&depth](std::size_t i) { return depth[i] > 0 ? depth[i] : no_value; };
  RankedValues depths(depth.count(), usable, context);
  return depths.at(std::array{depths.size() / 2}).front() / surface.camera.focal();
}

/// Robust plane through up to a million evenly spread vertices, which determine it to far better than a pixel.
Plane object_plane(const MeshInStrips& mesh, const Eigen::Vector3d& viewpoint, const Context& context) {
  const std::size_t stride = mesh.vertices / 1000003 + 1;
  std::vector<Eigen::Vector3d> spread((mesh.vertices + stride - 1) / stride);
  for_strips(mesh, context, [&](std::size_t, const MeshStrip& strip) {
    const std::size_t first = strip.first_vertex;
    for (std::size_t k = (first + stride - 1) / stride; k * stride < first + strip.vertices; ++k)
      spread[k] = strip.mesh.vertices.points[k * stride - first];
  });
  return fit_plane(spread, viewpoint, PlaneWeights::robust, context).plane;
}

/// Elevation model with its axes; its origin is the plane's centroid until allocate() moves it.
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

/// Moves the origin to the top-left corner of the vertices and allocates the raster. If it would be too large its
/// pixels grow, unless their size is what the user asks for.
void allocate(Dem& dem, const MeshInStrips& mesh, bool may_grow, const Context& context) {
  std::vector<Eigen::AlignedBox2d> boxes(mesh.strips);
  for_strips(mesh, context, [&](std::size_t k, const MeshStrip& strip) {
    for (const Eigen::Vector3d& x : strip.mesh.vertices.points) boxes[k].extend(raster_coordinates(dem, x).head<2>());
  });
  Eigen::AlignedBox2d box;
  for (const Eigen::AlignedBox2d& part : boxes) box.extend(part);
  const double growth = dem_growth(box.sizes());
  if (growth != 1 && !may_grow)
    throw resource_error("the elevation model would exceed 400 million pixels; raise surface.dem_pixel");
  if (growth != 1) {
    std::ostringstream message;
    message << "as fine as the mesh the elevation model would exceed 400 million pixels: its pixels are " << growth
            << " times as large (surface.dem_pixel)";
    context.log(LogLevel::warning, message.str());
  }
  dem.pixel *= growth;
  const Eigen::Array2d low = box.min().array() / growth, extent = (box.sizes().array() / growth).floor() + 1;
  dem.origin = dem.world(low.x(), low.y(), 0);
  dem.elevation = Image<float>({static_cast<int>(extent.x()), static_cast<int>(extent.y())}, 1, no_value);
}

/// Raises a pixel, which may have no elevation yet, to this one. The maximum does not depend on the order, so that the
/// raster does not depend on the threads.
void raise(float& pixel, float elevation) {
  std::atomic_ref<float> shared(pixel);
  float present = shared.load(std::memory_order_relaxed);
  while (!(elevation <= present) && !shared.compare_exchange_weak(present, elevation, std::memory_order_relaxed)) {
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

/// The numbers as the shortest texts that read back as the same: twelve digits are too few for a national grid.
std::string text_of(const Eigen::Vector3d& vector) {
  return shortest_text(vector.x()) + ' ' + shortest_text(vector.y()) + ' ' + shortest_text(vector.z());
}

}  // namespace

double dem_growth(const Eigen::Vector2d& sides) {
  constexpr double most = 4e8;
  const auto pixels = [&](double growth) { return ((sides.array() / growth).floor() + 1).prod(); };
  if (pixels(1) <= most) return 1;
  double growth = std::ceil(std::sqrt(pixels(1) / most));
  while (pixels(growth) > most) ++growth;  // by the fractions of a pixel at the borders
  return growth;
}

Dem dem_from_mesh(const TriangleMesh& mesh, const FusedSurface& surface, const SurfaceOptions& options,
                  const Context& context) {
  if (mesh.triangles.empty()) throw data_error("the mesh has no triangles, so there is no elevation model");
  MeshInStrips one_strip;
  one_strip.vertices = mesh.vertices.points.size();
  one_strip.strips = 1;
  one_strip.strip = [&mesh](std::size_t, MeshInStrips::Parts) {
    return MeshStrip{0, 0, mesh.vertices.points.size(), mesh};
  };
  return dem_from_mesh(one_strip, surface, options, context);
}

Dem dem_from_mesh(const MeshInStrips& mesh, const FusedSurface& surface, const SurfaceOptions& options,
                  const Context& context) {
  validate_fields(options, "surface");
  Dem dem = plane_frame(object_plane(mesh, surface.pose.center(), context), surface.pose);
  dem.pixel = options.dem_pixel ? *options.dem_pixel : median_gsd(surface, context) * options.subsample;
  allocate(dem, mesh, !options.dem_pixel, context);
  for_strips(mesh, context, [&](std::size_t, const MeshStrip& strip) {
    const std::vector<Eigen::Vector3d>& points = strip.mesh.vertices.points;
    for (const auto& [a, b, c] : strip.mesh.triangles) {
      rasterize(
          {raster_coordinates(dem, points[a]), raster_coordinates(dem, points[b]), raster_coordinates(dem, points[c])},
          dem.elevation);
    }
  });
  return dem;
}

void write_dem(const std::filesystem::path& path, const Dem& dem, const LengthUnit& unit, const std::string& name) {
  write_geotiff(path, dem.elevation,
                {.pixel = dem.pixel,
                 .unit = unit,
                 .title = name + ": plane fitted to the object",
                 .metadata = {{"WORLD_ORIGIN", text_of(dem.origin)},
                              {"WORLD_X_AXIS", text_of(dem.right)},
                              {"WORLD_Y_AXIS", text_of(dem.up)},
                              {"WORLD_Z_AXIS", text_of(dem.normal)}}});
}

}  // namespace malus
