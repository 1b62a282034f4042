#include "malus/surface/mesh.h"

#include <gtest/gtest.h>

#include <set>

#include "surface/scenes.h"
#include "thrown_error.h"

namespace malus {
namespace {

using namespace scenes;

FusedSurface sphere_surface(Size size) {
  const Pinhole camera = centered_camera(size, 1000);
  return surface_of(size, 1000, [&](int u, int v) { return sphere_depth(camera, {2, -3, 800}, 60, u, v); });
}

/// Centroid of a triangle and its normal (not a unit vector), world frame.
std::pair<Eigen::Vector3d, Eigen::Vector3d> face(const TriangleMesh& mesh, std::size_t index) {
  const auto& [a, b, c] = mesh.triangles[index];
  const auto& x = mesh.vertices.points;
  return {(x[a] + x[b] + x[c]) / 3, (x[b] - x[a]).cross(x[c] - x[a])};
}

std::size_t triangle_count(const FusedSurface& surface, const SurfaceOptions& options = {}) {
  return mesh_from_depth(surface, {}, options, {}).triangles.size();
}

TEST(Mesh, SphereLiesOnTheSphereInTheWorldAndFacesOutward) {
  const FusedSurface surface = sphere_surface({200, 180});
  const TriangleMesh mesh = mesh_from_depth(surface, {}, {}, {});
  const Eigen::Vector3d center = surface.pose.world_from_cam({2, -3, 800});
  ASSERT_GT(mesh.triangles.size(), 30000u);
  for (const Eigen::Vector3d& x : mesh.vertices.points) ASSERT_NEAR((x - center).norm(), 60, 2e-3);
  for (std::size_t i = 0; i < mesh.vertices.points.size(); ++i) {
    const Eigen::Vector3d outward = (mesh.vertices.points[i] - center).normalized();
    const Eigen::Vector3d to_camera = (surface.pose.center() - mesh.vertices.points[i]).normalized();
    const double bound = outward.dot(to_camera) > 0.5 ? 0.9999 : 0.9;  // differences are coarse near the rim
    ASSERT_GT(mesh.vertices.normals[i].cast<double>().dot(outward), bound);
  }
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    const auto [middle, normal] = face(mesh, t);
    ASSERT_GT(normal.dot(surface.pose.center() - middle), 0) << "counter-clockwise seen from the camera";
  }
}

TEST(Mesh, EveryVertexIsUsedAndEveryCellOfAPlaneHasTwoTriangles) {
  const Pinhole camera = centered_camera({50, 40}, 700);
  const FusedSurface plane = surface_of({50, 40}, 700, [&](int u, int v) {
    return plane_depth(camera, {0.2, 0.1, 1}, 400, u, v);
  });
  const TriangleMesh mesh = mesh_from_depth(plane, {}, {}, {});
  EXPECT_EQ(mesh.vertices.points.size(), 50u * 40u);
  EXPECT_EQ(mesh.triangles.size(), 2u * 49u * 39u);

  FusedSurface holes = plane;
  holes.depth(10, 10) = none;  // inside: each of its four cells keeps one triangle
  for (int u = 20; u < 50; ++u) holes.depth(u, 20) = none;
  holes.depth(0, 1) = holes.depth(1, 0) = holes.depth(1, 1) = none;  // (0, 0) remains alone and is dropped
  const TriangleMesh torn = mesh_from_depth(holes, {}, {}, {});
  std::set<std::uint32_t> used;
  for (const auto& triangle : torn.triangles) used.insert(triangle.begin(), triangle.end());
  EXPECT_EQ(used.size(), torn.vertices.points.size());
  EXPECT_EQ(torn.vertices.points.size(), 50u * 40u - 1 - 30 - 3 - 1);
}

TEST(Mesh, CutsAnOcclusionAndKeepsSteepRelief) {
  // Two walls 60 GSD apart: no triangle may join them.
  const FusedSurface step = surface_of({60, 60}, 1000, [](int u, int) { return u < 30 ? 500.0 : 530.0; });
  EXPECT_EQ(triangle_count(step), 2u * 59u * 59u - 2u * 59u);
  // A step of 6 GSD in one pixel is only 80.5° steep, but both sides are flat: it is a discontinuity.
  const FusedSurface small_step = surface_of({60, 60}, 1000, [](int u, int) { return u < 30 ? 500.0 : 503.0; });
  EXPECT_EQ(triangle_count(small_step), 2u * 59u * 59u - 2u * 59u);
  // A step of 3 GSD counts as carved relief.
  const FusedSurface edge = surface_of({60, 60}, 1000, [](int u, int) { return u < 30 ? 500.0 : 501.5; });
  EXPECT_EQ(triangle_count(edge), 2u * 59u * 59u);
  // A ramp of 6 GSD per pixel (80.5°) over five pixels is a real surface and stays whole, unless max_incidence_deg cuts
  // it.
  const FusedSurface ramp = surface_of({60, 60}, 1000, [](int u, int) { return 500.0 + 3 * std::clamp(u - 28, 0, 5); });
  EXPECT_EQ(triangle_count(ramp), 2u * 59u * 59u);
  SurfaceOptions strict;
  strict.max_incidence_deg = 70;
  EXPECT_EQ(triangle_count(ramp, strict), 2u * 59u * 59u - 5u * 2u * 59u);
}

TEST(Mesh, EndsWhereTheDepthIsTooUncertain) {
  FusedSurface plane = surface_of({50, 40}, 1000, [](int, int) { return 500.0; });
  plane.sigma = Image<float>({50, 40}, 1, 0.5f);  // 1 GSD
  for (int v = 0; v < 40; ++v) plane.sigma(0, v) = plane.sigma(1, v) = 6;
  plane.sigma(20, 20) = none;  // an unknown sigma does not cut
  EXPECT_EQ(triangle_count(plane), 2u * 47u * 39u);
  SurfaceOptions generous;
  generous.max_sigma_gsd = 13;
  EXPECT_EQ(triangle_count(plane, generous), 2u * 49u * 39u);
  // A GSD is depth / mean focal length, whatever the pixels' sides.
  FusedSurface wide = surface_of({50, 40}, 1000, [](int, int) { return 500.0; });
  wide.camera.fx = 1500;
  wide.camera.fy = 500;
  wide.sigma = Image<float>({50, 40}, 1, 4.9f);  // 9.8 GSD
  EXPECT_EQ(triangle_count(wide), 2u * 49u * 39u);
  plane.sigma = Image<float>({3, 3}, 1, 1);
  EXPECT_THROW(mesh_from_depth(plane, {}, {}, {}), Error);
}

TEST(Mesh, APriorThatIsUncertainEverywhereWidensTheUsualLimitOnly) {
  EXPECT_EQ(largest_sigma_gsd({}), 10);
  EXPECT_EQ(largest_sigma_gsd({}, 0.5), 10);
  EXPECT_EQ(largest_sigma_gsd({}, 14), 56);
  SurfaceOptions stated;
  stated.max_sigma_gsd = 3;
  EXPECT_EQ(largest_sigma_gsd(stated, 14), 3);
}

TEST(Mesh, SubsampledMeshKeepsTheCutsOfTheFullOne) {
  const FusedSurface step = surface_of({61, 61}, 1000, [](int u, int) { return u < 30 ? 500.0 : 510.0; });
  SurfaceOptions options;
  options.subsample = 4;
  const TriangleMesh mesh = mesh_from_depth(step, {}, options, {});
  EXPECT_EQ(mesh.vertices.points.size(), 16u * 16u);
  EXPECT_EQ(mesh.triangles.size(), 2u * 15u * 15u - 2u * 15u);
}

TEST(Mesh, ColorsAreSrgbScaledToThePercentile) {
  const FusedSurface flat = surface_of({40, 40}, 1000, [](int, int) { return 500.0; });
  Image<float> color(flat.depth.size(), 3, 0.0f);
  for (int v = 0; v < 40; ++v) {
    for (int u = 0; u < 40; ++u) {
      color(u, v, 0) = 0.4f;
      color(u, v, 1) = 0.2f;
      color(u, v, 2) = u == 0 ? none : 0.0f;
    }
  }
  const TriangleMesh mesh = mesh_from_depth(flat, color, {}, {});
  for (const Rgb& rgb : mesh.vertices.colors) ASSERT_EQ(rgb, (Rgb{255, 188, 0}));  // sRGB(0.5) = 187.5
  const TriangleMesh gray = mesh_from_depth(flat, Image<float>(flat.depth.size(), 1, 0.3f), {}, {});
  EXPECT_EQ(gray.vertices.colors[7], (Rgb{255, 255, 255}));
  EXPECT_TRUE(mesh_from_depth(flat, {}, {}, {}).vertices.colors.empty());
}

TEST(Mesh, IsTheSameWithAnyNumberOfThreads) {
  const FusedSurface surface = sphere_surface({203, 181});
  const Context three{.threads = 3};
  const Image<float> color(surface.depth.size(), 3, 0.2f);
  const TriangleMesh a = mesh_from_depth(surface, color, {}, {}), b = mesh_from_depth(surface, color, {}, three);
  EXPECT_EQ(a.triangles, b.triangles);
  EXPECT_EQ(a.vertices.points, b.vertices.points);
  EXPECT_EQ(a.vertices.normals, b.vertices.normals);
  EXPECT_EQ(a.vertices.colors, b.vertices.colors);
}

TEST(Mesh, RefusesWhatItCannotMesh) {
  const FusedSurface flat = surface_of({40, 40}, 1000, [](int, int) { return 500.0; });
  const auto expect_refused = [](ErrorCode code, const FusedSurface& surface, const Image<float>& color,
                                 const SurfaceOptions& options) {
    expect_error(code, [&] { mesh_from_depth(surface, color, options, {}); });
  };
  SurfaceOptions zero;
  zero.subsample = 0;
  expect_refused(ErrorCode::input, flat, {}, zero);
  expect_refused(ErrorCode::input, flat, Image<float>({39, 40}), {});
  expect_refused(ErrorCode::input, flat, Image<float>({40, 40}, 2), {});
  FusedSurface other = flat;
  other.normals = Image<float>({40, 40}, 1);
  expect_refused(ErrorCode::input, other, {}, {});
  other = flat;
  other.depth.fill(none);
  expect_refused(ErrorCode::data, other, {}, {});
  SurfaceOptions coarse;
  coarse.subsample = 64;
  expect_error(
      ErrorCode::data, [&] { mesh_from_depth(flat, {}, coarse, {}); }, "surface.subsample = 64");
}

}  // namespace
}  // namespace malus
