#include <gtest/gtest.h>

#include <random>

#include "malus/assess/comparison_internal.h"
#include "malus/assess/reference_surface_internal.h"
#include "malus/surface/mesh.h"
#include "surface/scenes.h"

namespace malus {
namespace {

using namespace scenes;

const Pinhole compared_camera = centered_camera({160, 120}, 1000);
constexpr double gsd = 0.5;

/// Wavy surface at about 500 mm, moved towards the camera by `offset` along its rays' z.
FusedSurface wavy(double offset, int columns = 160, int rows = 120) {
  return surface_of({columns, rows}, 1000, [&](int u, int v) {
    return 500 - offset + 3 * std::sin(u * 0.11) * std::cos(v * 0.09) + 0.02 * u;
  });
}

TriangleMesh mesh_of(const FusedSurface& surface) {
  return mesh_from_depth(surface, {}, {}, {});
}

/// A unit cube about the origin, with triangles that face outward.
TriangleMesh cube() {
  TriangleMesh mesh;
  for (int i = 0; i < 8; ++i) mesh.vertices.points.emplace_back((i & 1) - 0.5, (i >> 1 & 1) - 0.5, (i >> 2 & 1) - 0.5);
  mesh.triangles = {{0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6}, {0, 1, 4}, {1, 5, 4},
                    {2, 6, 3}, {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
  return mesh;
}

/// Signed distance to the unit cube in closed form.
double cube_distance(const Eigen::Vector3d& x) {
  const Eigen::Array3d d = x.array().abs() - 0.5;
  return d.max(0).matrix().norm() + std::min(d.maxCoeff(), 0.0);
}

TEST(Reference, DistanceAndSignToACubeAreExactAtFacesEdgesAndCorners) {
  const TriangleMesh mesh = cube();
  const ReferenceSurface reference(mesh, {}, 12, {});
  std::mt19937_64 random(9);
  std::uniform_real_distribution<double> uniform(-1.2, 1.2);
  for (int i = 0; i < 5000; ++i) {
    const Eigen::Vector3d x(uniform(random), uniform(random), uniform(random));
    const auto foot = reference.foot(x, 10);
    ASSERT_TRUE(foot);
    ASSERT_NEAR(foot->signed_distance, cube_distance(x), 1e-12) << x.transpose();
  }
  EXPECT_FALSE(reference.foot({3, 0, 0}, 2.4));
  EXPECT_TRUE(reference.foot({3, 0, 0}, 2.6));
}

TEST(Reference, SignsFarFromTheOriginAreThoseNearIt) {
  const Eigen::Vector3d far(5e8, 5.4e9, 3e5);  // millimeters in a national grid
  TriangleMesh mesh = cube();
  for (Eigen::Vector3d& point : mesh.vertices.points) point += far;
  const ReferenceSurface reference(mesh, {}, 12, {});
  std::mt19937_64 random(9);
  std::uniform_real_distribution<double> uniform(-1.2, 1.2);
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector3d x(uniform(random), uniform(random), uniform(random));
    const auto foot = reference.foot(x + far, 10);
    ASSERT_TRUE(foot);
    ASSERT_NEAR(foot->signed_distance, cube_distance(x), 1e-5) << x.transpose();
  }
}

TEST(Reference, TreeSearchAgreesWithExhaustiveSearch) {
  const TriangleMesh mesh = mesh_of(wavy(0, 40, 30));
  const ReferenceSurface reference(mesh, some_pose().center(), 12, {});
  TriangleMesh one;
  one.vertices.points = mesh.vertices.points;
  const FusedSurface other = wavy(2, 40, 30);
  for (int i = 0; i < 40; ++i) {
    const Eigen::Vector3d x =
        other.pose.world_from_cam(compared_camera.ray(i, 7) * static_cast<double>(other.depth(i, 7)));
    double nearest = 1e9;
    for (const auto& triangle : mesh.triangles) {
      one.triangles = {triangle};
      nearest = std::min(nearest, std::abs(ReferenceSurface(one, {}, 12, {}).foot(x, 1e9)->signed_distance));
    }
    ASSERT_NEAR(std::abs(reference.foot(x, 1e9)->signed_distance), nearest, 1e-12);
  }
}

TEST(Comparison, SphereAgainstItsMeshAndItsCloud) {
  const auto sphere = [](double radius) {
    return surface_of(compared_camera.size, 1000, [&](int u, int v) {
      return sphere_depth(compared_camera, {0, 0, 600}, radius, u, v);
    });
  };
  const FusedSurface surface = sphere(101);
  TriangleMesh reference = mesh_of(sphere(100));
  AssessOptions options;
  options.histogram_range_gsd = 3;
  const ReferenceComparison to_mesh = compare_with_reference(surface, reference, gsd, options, {});
  EXPECT_EQ(to_mesh.status, ComparisonStatus::done);
  EXPECT_NEAR(to_mesh.distance_gsd.median, 2, 2e-3) << "in front of the reference by 1 mm";
  EXPECT_NEAR(to_mesh.distance_gsd.mean, 2, 0.02);
  reference.triangles.clear();
  for (const bool with_normals : {true, false}) {
    if (!with_normals) reference.vertices.normals.clear();
    const ReferenceComparison to_cloud = compare_with_reference(surface, reference, gsd, options, {});
    EXPECT_NEAR(to_cloud.distance_gsd.median, 2, 0.01);
    EXPECT_GT(to_cloud.compared_fraction, 0.99);
  }
}

TEST(Comparison, PointsWithoutNormalsFaceTheCamera) {
  const FusedSurface surface = wavy(1);
  TriangleMesh reference = mesh_of(wavy(0));
  reference.triangles.clear();
  for (std::size_t i = 0; i < reference.vertices.normals.size(); ++i) {
    if (i % 160 < 80) reference.vertices.normals[i].setZero();
  }
  const ReferenceComparison result = compare_with_reference(surface, reference, gsd, {}, {});
  EXPECT_GT(result.distance_gsd.p05, 1) << "the surface is in front of the reference";
}

TEST(Comparison, TheOutsideOfAReferenceTurnedInsideOutFacesTheCamera) {
  TriangleMesh clockwise = mesh_of(wavy(0));
  for (auto& triangle : clockwise.triangles) std::swap(triangle[1], triangle[2]);
  TriangleMesh cloud = mesh_of(wavy(0));
  cloud.triangles.clear();
  for (Eigen::Vector3f& normal : cloud.vertices.normals) normal = -normal;
  for (const TriangleMesh& reference : {clockwise, cloud}) {
    const ReferenceComparison result = compare_with_reference(wavy(gsd), reference, gsd, {}, {});
    EXPECT_NEAR(result.distance_gsd.median, 0.93, 0.1) << "the surface is in front of the reference";
  }
}

TEST(Comparison, TheOutsideOfAClosedMeshOfClockwiseTrianglesIsThatOfTheSurface) {
  TriangleMesh clockwise = cube();
  for (auto& triangle : clockwise.triangles) std::swap(triangle[1], triangle[2]);
  const std::vector<Eigen::Vector3d> outside{{0, 0, 0.6}, {0, -0.7, 0}, {0.4, 0, 0}},
      directions{{0, 0, 1}, {0, -1, 0}, {1, 0, 0}};
  for (const TriangleMesh& reference : {cube(), clockwise}) {
    const std::vector<float> found = distances_from_reference(outside, directions, reference, 1, {}, {});
    EXPECT_NEAR(found[0], 0.1, 1e-6);
    EXPECT_NEAR(found[1], 0.2, 1e-6);
    EXPECT_NEAR(found[2], -0.1, 1e-6);
  }
}

TEST(Comparison, SignedDistancesAreRightAllAroundAClosedCloud) {
  PointCloud ball;
  std::vector<Eigen::Vector3d> outside, directions;
  for (int i = 0; i < 4000; ++i) {
    const double z = 1 - (i + 0.5) / 2000, turn = 2.399963 * i, r = std::sqrt(1 - z * z);
    const Eigen::Vector3d direction(r * std::cos(turn), r * std::sin(turn), z);
    ball.points.push_back(20 * direction);
    directions.push_back(direction);
    outside.push_back((i % 2 == 0 ? 20.6 : 19.8) * direction);
  }
  const std::vector<float> found = distances_from_reference(outside, directions, {ball, {}}, gsd, {}, {});
  // A plane fitted to twelve points of the ball lies slightly inside it.
  for (std::size_t i = 0; i < found.size(); ++i) ASSERT_NEAR(found[i], i % 2 == 0 ? 0.6 : -0.2, 0.1) << i;
  AssessOptions near;
  near.max_distance_gsd = 0.5;
  const std::vector<float> nothing = distances_from_reference(std::vector(outside.begin(), outside.begin() + 1),
                                                              directions, {ball, {}}, gsd, near, {});
  EXPECT_TRUE(std::isnan(nothing.at(0)));
}

TEST(Comparison, AlignsThePointsOfAnySurface) {
  const FusedSurface surface = wavy(0);
  const TriangleMesh reference = mesh_of(surface);
  const Eigen::Vector3d shift(0.5, -0.4, 0.6);
  std::vector<Eigen::Vector3d> moved = reference.vertices.points;
  for (Eigen::Vector3d& x : moved) x += shift;
  AssessOptions options;
  options.alignment = Alignment::rigid;
  const PointAlignment found = align_with_reference(moved, reference, gsd, options, {});
  EXPECT_TRUE(found.converged);
  EXPECT_LT((found.reference_from_surface.apply(moved[999]) - reference.vertices.points[999]).norm(), 0.01);
  EXPECT_FALSE(align_with_reference(std::span(moved).first(5), reference, gsd, options, {}).converged);
}

TEST(Comparison, AlignsFarFromTheOriginAsNearIt) {
  // In meters and UTM: a billionth of the coordinates is 5 mm, which is 53 GSD.
  constexpr double meters_per_unit = 2e-4;
  const Eigen::Vector3d utm(450e3, 5.3e6, 120), shift(5e-5, -4e-5, 6e-5);
  TriangleMesh reference = mesh_of(wavy(0));
  std::vector<Eigen::Vector3d> moved;
  for (std::size_t i = 0; i < reference.vertices.points.size(); ++i) {
    Eigen::Vector3d& x = reference.vertices.points[i];
    x = utm + meters_per_unit * x;
    if (i % 97 == 0) moved.push_back(x + shift);
  }
  AssessOptions options;
  options.alignment = Alignment::rigid;
  const PointAlignment found = align_with_reference(moved, reference, meters_per_unit * gsd, options, {});
  EXPECT_TRUE(found.converged);
  EXPECT_LT((found.reference_from_surface.apply(moved[99]) - moved[99] + shift).norm(), 1e-6);
}

TEST(Comparison, FarPixelsAreLeftOutAndReported) {
  const FusedSurface half = wavy(0, 80, 120);
  FusedSurface reference_view = half;
  reference_view.camera = compared_camera;
  reference_view.depth = Image<float>(compared_camera.size, 1, none);
  for (int v = 0; v < 120; ++v) {
    for (int u = 0; u < 80; ++u) reference_view.depth(u, v) = wavy(0).depth(u, v);
  }
  AssessOptions options;
  options.max_distance_gsd = 1;
  const ReferenceComparison result = compare_with_reference(wavy(0), mesh_of(reference_view), gsd, options, {});
  EXPECT_NEAR(result.compared_fraction, 0.5, 0.02);
  EXPECT_LT(std::abs(result.distance(40, 60)), 1e-4);
  EXPECT_TRUE(std::isnan(result.distance(120, 60)));
  std::string said;
  Context context;
  context.on_log = [&](LogLevel, const std::string& message) { said += message; };
  const ReferenceComparison nothing = compare_with_reference(wavy(5), mesh_of(reference_view), gsd, options, context);
  EXPECT_EQ(nothing.status, ComparisonStatus::nothing_near);
  EXPECT_NE(said.find("no pixel is near the reference"), std::string::npos) << said;
  EXPECT_NE(said.find("--register"), std::string::npos) << said;
  said.clear();
  options.alignment = Alignment::rigid;
  const ReferenceComparison aligned = compare_with_reference(wavy(5), mesh_of(reference_view), gsd, options, context);
  EXPECT_EQ(aligned.status, ComparisonStatus::nothing_near);
  EXPECT_EQ(aligned.alignment_iterations, 0);
  EXPECT_EQ(said.find("alignment"), std::string::npos) << said;
}

TEST(Comparison, SaysThatTooFewPixelsAreNearToAlign) {
  const std::vector<Eigen::Vector3d> all = mesh_of(wavy(0)).vertices.points;
  TriangleMesh of_nine_pixels;
  for (const std::size_t v : {60, 62}) {
    for (const std::size_t u : {40, 42}) of_nine_pixels.vertices.points.push_back(all.at(160 * v + u));
  }
  of_nine_pixels.triangles = {{0, 1, 2}, {2, 1, 3}};
  std::string said;
  Context context;
  context.on_log = [&](LogLevel, const std::string& message) { said += message; };
  AssessOptions options;
  options.alignment = Alignment::rigid;
  options.max_distance_gsd = 2;  // farther away the waves rise above the small plane
  const ReferenceComparison result = compare_with_reference(wavy(0), of_nine_pixels, gsd, options, context);
  EXPECT_EQ(result.status, ComparisonStatus::too_few_near);
  EXPECT_EQ(result.alignment_iterations, 0);
  EXPECT_NE(said.find("too few pixels are near the reference"), std::string::npos) << said;
  EXPECT_EQ(said.find("still moves"), std::string::npos) << said;
}

TEST(Comparison, PixelsBesideAReferenceOfAPartAreNotCompared) {
  // Up to 50 GSD beyond its border, the distance to the nearest place of the reference is one along the surface.
  FusedSurface part = wavy(0);
  for (int v = 0; v < 120; ++v) {
    for (int u = 80; u < 160; ++u) part.depth(u, v) = none;
  }
  TriangleMesh reference = mesh_of(part);
  for (const bool is_mesh : {true, false}) {
    if (!is_mesh) reference.triangles.clear();
    const ReferenceComparison result = compare_with_reference(wavy(0.5 * gsd), reference, gsd, {}, {});
    EXPECT_NEAR(result.compared_fraction, 0.5, 0.03) << is_mesh;
    EXPECT_NEAR(result.distance_gsd.rmse, 0.45, 0.1) << is_mesh;
  }
}

TEST(Comparison, ReportsAReferenceOffsetFromTheSurface) {
  const TriangleMesh reference = mesh_of(wavy(0));
  std::string said;
  Context context;
  context.on_log = [&](LogLevel, const std::string& message) { said += message; };
  AssessOptions options;
  compare_with_reference(wavy(4 * gsd), reference, gsd, options, context);
  EXPECT_TRUE(said.empty()) << said;
  const ReferenceComparison beside = compare_with_reference(wavy(8 * gsd), reference, gsd, options, context);
  EXPECT_EQ(beside.status, ComparisonStatus::done);
  EXPECT_NE(said.find("farther than 5 GSD from the reference"), std::string::npos) << said;
  EXPECT_NE(said.find("--register"), std::string::npos) << said;
}

TEST(Comparison, ReportsAReferenceCloudWhoseNoiseExceedsItsSpacing) {
  TriangleMesh clean = mesh_of(wavy(0));
  clean.triangles.clear();
  clean.vertices.normals.clear();
  const auto compared = [&](double noise, std::string& said) {
    std::mt19937_64 random(3);
    std::normal_distribution<double> normal(0, noise);
    TriangleMesh reference = clean;
    for (Eigen::Vector3d& point : reference.vertices.points)
      point += Eigen::Vector3d(normal(random), normal(random), normal(random));
    Context context;
    context.on_log = [&](LogLevel, const std::string& message) { said += message; };
    return compare_with_reference(wavy(gsd), reference, gsd, {}, context);
  };
  std::string of_fine, of_coarse;
  EXPECT_NEAR(compared(0.1 * gsd, of_fine).distance_gsd.median, 0.93, 0.1);
  EXPECT_TRUE(of_fine.empty()) << of_fine;
  EXPECT_LT(compared(1.5 * gsd, of_coarse).distance_gsd.median, 0.7) << "the reason for the warning";
  EXPECT_NE(of_coarse.find("more than half of their spacing"), std::string::npos) << of_coarse;
}

TEST(Comparison, ReportsAReferenceCloudOfDistantLines) {
  const TriangleMesh all = mesh_of(wavy(0));
  const auto said_of = [&](std::size_t rows_apart) {
    TriangleMesh lines;
    for (std::size_t i = 0; i < all.vertices.points.size(); ++i) {
      if (i / 160 % rows_apart == 0) lines.vertices.points.push_back(all.vertices.points[i]);
    }
    std::string said;
    Context context;
    context.on_log = [&](LogLevel, const std::string& message) { said += message; };
    compare_with_reference(wavy(gsd), lines, gsd, {}, context);
    return said;
  };
  EXPECT_TRUE(said_of(3).empty()) << said_of(3);
  EXPECT_NE(said_of(12).find("along lines"), std::string::npos) << said_of(12);
}

TEST(Comparison, IcpUndoesAKnownMotionAndIsOffByDefault) {
  const FusedSurface surface = wavy(0);
  TriangleMesh reference = mesh_of(surface);
  const Eigen::Vector3d middle = reference.vertices.points[reference.vertices.points.size() / 2];
  for (const double scale : {1.0, 1.004}) {
    TriangleMesh moved = reference;
    const Eigen::Matrix3d turn = Eigen::AngleAxisd(0.01, Eigen::Vector3d(0.2, 1, -0.4).normalized()).toRotationMatrix();
    for (Eigen::Vector3d& x : moved.vertices.points)
      x = middle + scale * turn * (x - middle) + Eigen::Vector3d(0.5, -0.4, 0.6);
    AssessOptions options;
    EXPECT_GT(compare_with_reference(surface, moved, gsd, options, {}).distance_gsd.rmse, 0.5);
    options.alignment = scale == 1 ? Alignment::rigid : Alignment::similarity;
    const ReferenceComparison aligned = compare_with_reference(surface, moved, gsd, options, {});
    EXPECT_EQ(aligned.status, ComparisonStatus::done);
    EXPECT_LT(aligned.distance_gsd.rmse, 0.002);
    EXPECT_NEAR(aligned.reference_from_surface.scale, scale, 1e-5);
    EXPECT_LT((aligned.reference_from_surface.apply(middle) - middle - Eigen::Vector3d(0.5, -0.4, 0.6)).norm(), 0.01);
  }
}

TEST(Comparison, IcpOnAPlaneDoesNotSlide) {
  const auto plane = [](double offset) {
    return surface_of(compared_camera.size, 1000, [&](int u, int v) {
      return plane_depth(compared_camera, Eigen::Vector3d(0.1, 0.2, 1).normalized(), offset, u, v);
    });
  };
  AssessOptions options;
  options.alignment = Alignment::rigid;
  const ReferenceComparison result = compare_with_reference(plane(500), mesh_of(plane(502)), gsd, options, {});
  EXPECT_NEAR(result.distance_gsd.median, 0, 1e-4);  // a few pixels extend beyond the reference's border
  EXPECT_LT(result.distance_gsd.mad, 1e-3);
  EXPECT_NEAR(result.reference_from_surface.translation.norm(), 2, 0.05);
}

TEST(Comparison, SameWithAnyNumberOfThreads) {
  const Context three{.threads = 3};
  AssessOptions options;
  options.alignment = Alignment::rigid;
  TriangleMesh reference = mesh_of(wavy(0.3));
  for (const bool is_mesh : {true, false}) {
    if (!is_mesh) reference.triangles.clear();
    const ReferenceComparison a = compare_with_reference(wavy(0), reference, gsd, options, {});
    const ReferenceComparison b = compare_with_reference(wavy(0), reference, gsd, options, three);
    EXPECT_EQ(a.distance_gsd.rmse, b.distance_gsd.rmse);
    EXPECT_EQ(a.reference_from_surface.translation, b.reference_from_surface.translation);
    for (std::size_t i = 0; i < a.distance.count(); ++i) {
      ASSERT_TRUE(a.distance[i] == b.distance[i] || (std::isnan(a.distance[i]) && std::isnan(b.distance[i])));
    }
  }
}

TEST(Comparison, RefusesUnusableReferences) {
  const FusedSurface surface = wavy(0);
  EXPECT_THROW(compare_with_reference(surface, {}, gsd, {}, {}), Error);
  TriangleMesh broken = cube();
  broken.triangles.push_back({0, 1, 8});
  EXPECT_THROW(compare_with_reference(surface, broken, gsd, {}, {}), Error);
  broken = cube();
  broken.vertices.points[3].y() = NAN;
  EXPECT_THROW(compare_with_reference(surface, broken, gsd, {}, {}), Error);
}

}  // namespace
}  // namespace malus
