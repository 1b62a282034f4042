#include <gtest/gtest.h>

#include "malus/surface/dem_internal.h"
#include "surface/scenes.h"
#include "thrown_error.h"

namespace malus {
namespace {

using namespace scenes;

const Eigen::Vector3d tilted = Eigen::Vector3d(0.15, -0.1, 1).normalized();

/// A tilted plane (camera frame) with a raised square of known elevation on it.
FusedSurface mesa(double height) {
  const Pinhole camera = centered_camera({160, 120}, 1000);
  return surface_of(camera.size, 1000, [&](int u, int v) {
    const bool on_top = std::abs(u - 60) < 10 && std::abs(v - 40) < 10;
    return plane_depth(camera, tilted, 500 - (on_top ? height : 0), u, v);
  });
}

TEST(Dem, PlaneIsZeroAndAStepHasItsHeight) {
  const FusedSurface surface = mesa(1.25);
  const Dem dem = dem_from_mesh(mesh_from_depth(surface, {}, {}, {}), surface, {}, {});
  EXPECT_NEAR(dem.pixel, 0.5, 0.01);
  const Eigen::Vector3d to_camera_in_world = -(surface.pose.rotation.transpose() * tilted);
  EXPECT_GT(dem.normal.dot(to_camera_in_world), 1 - 1e-9);
  EXPECT_NEAR(dem.right.cross(dem.up).dot(dem.normal), 1, 1e-12);
  std::size_t finite = 0, flat = 0, top = 0;
  for (const float z : dem.elevation) {
    finite += std::isfinite(z);
    flat += std::abs(z) < 1e-3f;
    top += std::abs(z - 1.25f) < 1e-3f;
  }
  EXPECT_GT(static_cast<double>(finite), 0.9 * static_cast<double>(dem.elevation.count()));
  EXPECT_GT(flat + top, finite - 200);
  EXPECT_NEAR(static_cast<double>(top), 19 * 19, 60);
}

TEST(Dem, RasterIsOrientedLikeTheImageAndItsFrameMapsBackToTheSurface) {
  const FusedSurface surface = mesa(1.25);
  const Dem dem = dem_from_mesh(mesh_from_depth(surface, {}, {}, {}), surface, {}, {});
  double column_sum = 0, row_sum = 0, count = 0;
  for (int row = 0; row < dem.elevation.height(); ++row) {
    for (int column = 0; column < dem.elevation.width(); ++column) {
      const float z = dem.elevation(column, row);
      if (!std::isfinite(z)) continue;
      const Eigen::Vector3d in_cam = surface.pose.cam_from_world(dem.world(column, row, z));
      const Eigen::Vector2d pixel = surface.camera.project(in_cam);
      ASSERT_GT(pixel.x(), -0.01);
      ASSERT_LT(pixel.x(), 159.01);
      if (z > 1.2f) {
        ASSERT_NEAR(in_cam.dot(tilted), 500 - z, 1e-3);
        column_sum += pixel.x(), row_sum += pixel.y(), count += 1;
      }
    }
  }
  EXPECT_NEAR(column_sum / count, 60, 0.5);
  EXPECT_NEAR(row_sum / count, 40, 0.5);
}

TEST(Dem, NoGapsBetweenTriangles) {
  const Pinhole camera = centered_camera({80, 60}, 1000);
  const FusedSurface surface = surface_of(camera.size, 1000, [&](int u, int v) {
    return sphere_depth(camera, {0, 0, 900}, 400, u, v);
  });
  SurfaceOptions fine;
  fine.dem_pixel = 0.11;
  const Dem dem = dem_from_mesh(mesh_from_depth(surface, {}, {}, {}), surface, fine, {});
  const int middle = dem.elevation.height() / 2;
  for (int row = middle - 50; row < middle + 50; ++row) {
    for (int column = 20; column < dem.elevation.width() - 20; ++column)
      ASSERT_TRUE(std::isfinite(dem.elevation(column, row)));
  }
}

TEST(Dem, SameWithAnyNumberOfThreads) {
  const FusedSurface surface = mesa(3);
  const TriangleMesh mesh = mesh_from_depth(surface, {}, {}, {});
  const Context three{.threads = 3};
  const Dem a = dem_from_mesh(mesh, surface, {}, {}), b = dem_from_mesh(mesh, surface, {}, three);
  ASSERT_EQ(a.elevation.size(), b.elevation.size());
  for (std::size_t i = 0; i < a.elevation.count(); ++i) {
    ASSERT_TRUE(a.elevation[i] == b.elevation[i] || (std::isnan(a.elevation[i]) && std::isnan(b.elevation[i])));
  }
}

TEST(Dem, PixelsGrowAsFarAsALargeRasterNeeds) {
  EXPECT_EQ(dem_growth({19999, 19999}), 1);
  EXPECT_EQ(dem_growth({20000, 19999}), 2) << "an image of 400 megapixels and a row";
  EXPECT_EQ(dem_growth({60000, 60000}), 4) << "at three times, 20001 x 20001";
  EXPECT_GT(dem_growth({1e14, 1e14}), 4e9);
}

TEST(Dem, RefusesAnEmptyMeshAndAHugeRaster) {
  const FusedSurface surface = mesa(1);
  EXPECT_THROW(dem_from_mesh(TriangleMesh{}, surface, {}, {}), Error);
  SurfaceOptions tiny;
  tiny.dem_pixel = 1e-4;
  expect_error(ErrorCode::resource, [&] { dem_from_mesh(mesh_from_depth(surface, {}, {}, {}), surface, tiny, {}); });
}

}  // namespace
}  // namespace malus
