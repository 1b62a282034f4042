#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <string>

#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/length_unit_internal.h"
#include "malus/surface/mesh.h"

namespace malus {

/// Elevation of a surface above the plane fitted to it: a regular raster, oriented like the station image.
struct Dem {
  Image<float> elevation;  ///< station unit, positive towards the camera; NaN = none
  double pixel = 0;        ///< size of a pixel in both directions, station unit
  /// Frame of the raster in the world: `right` and `up` lie in the plane (up = towards smaller rows), `normal` towards
  /// the camera; right × up = normal. `origin` is the center of the top-left pixel, on the plane.
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::UnitX();
  Eigen::Vector3d up = Eigen::Vector3d::UnitY();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();

  /// World point at a raster position (column, row) and elevation.
  Eigen::Vector3d world(double column, double row, double height) const {
    return origin + pixel * (column * right - row * up) + height * normal;
  }
};

/// Elevation model of a mesh made from this surface: the plane is fitted robustly to the vertices, its x axis is the
/// camera's x axis projected into it, and the triangles are rasterized (linear inside each; the highest is kept where
/// the surface overhangs). The pixel is options.dem_pixel, or depth / focal at the median depth times
/// options.subsample, times dem_growth with a warning. Throws a data error for a mesh without triangles or a plane seen
/// edge-on, a resource error if a raster with options.dem_pixel would exceed 400 million pixels.
Dem dem_from_mesh(const TriangleMesh& mesh, const FusedSurface& surface, const SurfaceOptions& options,
                  const Context& context);
/// The same for a mesh that is not in memory.
Dem dem_from_mesh(const MeshInStrips& mesh, const FusedSurface& surface, const SurfaceOptions& options,
                  const Context& context);

/// Writes a GeoTIFF of an elevation model in the coordinate system of its plane; WORLD_ORIGIN, WORLD_X_AXIS,
/// WORLD_Y_AXIS and WORLD_Z_AXIS in its metadata are the plane's frame in the world (Dem::origin, right, up, normal).
/// Atomic.
void write_dem(const std::filesystem::path& path, const Dem& dem, const LengthUnit& unit, const std::string& name);

/// Whole factor by which pixels must grow so that a raster with these sides [px] has at most 400 million of them.
double dem_growth(const Eigen::Vector2d& sides);

}  // namespace malus
