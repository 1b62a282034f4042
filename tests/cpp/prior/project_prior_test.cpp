#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <atomic>
#include <cmath>
#include <functional>
#include <limits>
#include <random>
#include <string>

#include "malus/core/error.h"
#include "malus/prior/project_prior_internal.h"
#include "malus/prior/rasterize_mesh_internal.h"
#include "malus/prior/rounded_points_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

constexpr double focal = 800, distance_mm = 400, gsd_mm = distance_mm / focal;

Pinhole test_camera() {
  return {{120, 90}, focal, focal, 60, 44};
}

Pose test_pose() {
  Pose pose;
  pose.rotation = (Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitX()) * Eigen::AngleAxisd(-0.3, Eigen::Vector3d::UnitY()))
                      .toRotationMatrix();
  pose.translation = {10, -20, 350};
  return pose;
}

Mask full_mask() {
  return Mask(test_camera().size, 1, 255);
}

using Depth = std::function<double(double u, double v)>;

double plane_depth(double u, double v) {
  const Eigen::Vector3d normal = Eigen::Vector3d(0.4, 0.2, -1).normalized();
  return normal.z() * distance_mm / normal.dot(test_camera().ray(u, v));
}

double wavy_depth(double u, double v) {
  return distance_mm + 12 * gsd_mm * std::sin(u / 14) * std::cos(v / 17) + 0.05 * (u - 60);
}

/// Points of a surface at random pixels, in the world, with Gaussian noise along the ray.
PointCloud sample(const Depth& depth, int count, double noise_gsd, unsigned seed = 1) {
  const Pinhole camera = test_camera();
  std::mt19937 generator(seed);
  std::uniform_real_distribution<double> u_of(-0.5, camera.size.width - 0.5), v_of(-0.5, camera.size.height - 0.5);
  std::normal_distribution<double> noise(0, noise_gsd * gsd_mm);
  PointCloud cloud;
  for (int i = 0; i < count; ++i) {
    const double u = u_of(generator), v = v_of(generator);
    cloud.points.push_back(test_pose().world_from_cam((depth(u, v) + noise(generator)) * camera.ray(u, v)));
  }
  return cloud;
}

void add(PointCloud& cloud, const PointCloud& more) {
  cloud.points.insert(cloud.points.end(), more.points.begin(), more.points.end());
  cloud.normals.insert(cloud.normals.end(), more.normals.begin(), more.normals.end());
}

/// Root mean square depth error in GSD over the pixels `inside`.
double rms_gsd(
    const Image<float>& depth, const Depth& truth,
    const std::function<bool(int, int)>& inside = [](int, int) { return true; }) {
  double sum = 0;
  int count = 0;
  for (int v = 0; v < depth.height(); ++v) {
    for (int u = 0; u < depth.width(); ++u) {
      if (!inside(u, v)) continue;
      const double error = (depth(u, v) - truth(u, v)) / gsd_mm;
      sum += error * error;
      ++count;
    }
  }
  return std::sqrt(sum / count);
}

template <class Source>
DepthPrior project(const Source& source, const PriorOptions& options = {}, const Mask& mask = full_mask(),
                   const Context& context = {}) {
  return project_prior(source, test_camera(), test_pose(), mask, options, context);
}

TEST(PriorOfCloud, ReproducesNoiselessSurfaces) {
  EXPECT_LT(rms_gsd(project(sample(plane_depth, 1500, 0)).depth, plane_depth), 0.02);
  EXPECT_LT(rms_gsd(project(sample(wavy_depth, 3000, 0)).depth, wavy_depth), 0.1);
}

TEST(PriorOfCloud, SmoothsNoiseIgnoresOutliersAndEstimatesItsError) {
  PointCloud cloud = sample(wavy_depth, 3000, 2);
  add(cloud, sample([](double u, double v) { return wavy_depth(u, v) + 40 * gsd_mm; }, 100, 10, 7));
  PriorOptions options;
  options.correlated_noise = 0;
  options.smoothing_scale = 1;
  const DepthPrior prior = project(cloud, options);
  EXPECT_LT(rms_gsd(prior.depth, wavy_depth), 0.6);
  EXPECT_NEAR(prior.noise / gsd_mm, 2, 0.3);
  // Errors of neighboring pixels are correlated, so that their mean square scatters by about 10 %.
  double sum = 0;
  for (int v = 0; v < 90; ++v) {
    for (int u = 0; u < 120; ++u) sum += std::pow((prior.depth(u, v) - wavy_depth(u, v)) / prior.sigma(u, v), 2);
  }
  EXPECT_NEAR(std::sqrt(sum / (120.0 * 90)), 0.9, 0.3);
}

TEST(PriorOfCloud, NoisierCloudIsSmoothedMore) {
  const double fine = project(sample(wavy_depth, 3000, 0.2)).smoothing_px;
  const double coarse = project(sample(wavy_depth, 3000, 4)).smoothing_px;
  EXPECT_GT(coarse, 1.3 * fine);
}

/// Gives every point the surface's normal, turned by random angles of this standard deviation.
void add_normals(PointCloud& cloud, const Depth& depth, double spread_rad) {
  const Pinhole camera = test_camera();
  std::mt19937 generator(3);
  std::normal_distribution<double> turn(0, spread_rad);
  for (const Eigen::Vector3d& point : cloud.points) {
    const Eigen::Vector2d at = camera.project(test_pose().cam_from_world(point));
    const auto position = [&](double du, double dv) {
      const Eigen::Vector2d pixel = at + Eigen::Vector2d(du, dv);
      return Eigen::Vector3d(depth(pixel.x(), pixel.y()) * camera.ray(pixel.x(), pixel.y()));
    };
    Eigen::Vector3d normal =
        (position(0, 0.5) - position(0, -0.5)).cross(position(0.5, 0) - position(-0.5, 0)).normalized();
    normal =
        (normal + normal.unitOrthogonal() * turn(generator) + normal.cross(normal.unitOrthogonal()) * turn(generator))
            .normalized();
    cloud.normals.push_back((test_pose().rotation.transpose() * normal).cast<float>());
  }
}

TEST(PriorOfCloud, NormalsReduceTheError) {
  PointCloud cloud = sample(wavy_depth, 1500, 2);
  const double without = rms_gsd(project(cloud).depth, wavy_depth);
  add_normals(cloud, wavy_depth, 0.05);
  EXPECT_LT(rms_gsd(project(cloud).depth, wavy_depth), 0.6 * without);
}

TEST(PriorOfCloud, WrongNormalsDoLittleHarm) {
  PointCloud cloud = sample(wavy_depth, 1500, 2);
  const double without = rms_gsd(project(cloud).depth, wavy_depth);
  add_normals(cloud, wavy_depth, 0.5);
  EXPECT_LT(rms_gsd(project(cloud).depth, wavy_depth), 1.2 * without);
}

/// Depth with a round, steep-edged plateau in the middle, 14 GSD nearer.
Depth with_plateau(const Depth& depth) {
  return [depth](double u, double v) {
    return depth(u, v) - 7 * gsd_mm * (1 + std::tanh((18 - std::hypot(u - 60, v - 44)) / 0.5));
  };
}

TEST(PriorOfCloud, KeepsAPartThatStandsOut) {
  // The points' normals do not show the step, and stray points lie as far in front of the surface as the plateau is
  // high.
  const Depth surface = with_plateau(plane_depth);
  PointCloud cloud = sample(surface, 3000, 1);
  add_normals(cloud, surface, 0.1);
  PointCloud stray = sample([&](double u, double v) { return surface(u, v) - 14 * gsd_mm; }, 90, 2, 7);
  add_normals(stray, surface, 0.1);
  add(cloud, stray);
  const Image<float> depth = project(cloud).depth;
  const auto from_edge = [](int u, int v) { return std::hypot(u - 60, v - 44) - 18; };
  EXPECT_LT(rms_gsd(depth, surface, [&](int u, int v) { return from_edge(u, v) < -5; }), 1);
  EXPECT_LT(rms_gsd(depth, surface, [&](int u, int v) { return from_edge(u, v) > 5; }), 1);
}

TEST(PriorOfCloud, NormalsDoNotSpreadAStepOverItsSurroundings) {
  // A ring 16 GSD high. Normals determine the slope of the ground well, but give no information about the ring's walls.
  const auto from_middle = [](double u, double v) { return std::hypot(u - 60, v - 44); };
  const Depth surface = [&](double u, double v) {
    const double r = from_middle(u, v);
    return plane_depth(u, v) - 8 * gsd_mm * (std::tanh((r - 22) / 0.7) - std::tanh((r - 38) / 0.7));
  };
  double ring = 0;
  for (const unsigned seed : {1U, 2U, 3U}) {
    PointCloud cloud = sample(surface, 1500, 2, seed);
    add_normals(cloud, surface, 0.05);
    const Image<float> depth = project(cloud).depth;
    ring += rms_gsd(depth, surface, [&](int u, int v) { return std::abs(from_middle(u, v) - 30) < 4; }) / 3;
  }
  EXPECT_LT(ring, 0.54);
}

TEST(PriorOfCloud, ErrorsOfSteepPointsAreMeasuredAcrossTheSurface) {
  // A sphere up to 80° from its center, with points of the same uncertainty in every direction.
  constexpr double radius_px = 44;
  const Depth sphere = [](double u, double v) {
    const double r2 = ((u - 60) * (u - 60) + (v - 44) * (v - 44)) / (radius_px * radius_px);
    return distance_mm - radius_px * gsd_mm * std::sqrt(std::max(1 - r2, 0.03));
  };
  const auto shown = [](int u, int v) { return std::hypot(u - 60, v - 44) < 0.97 * radius_px; };
  Mask mask = full_mask();
  for (int v = 0; v < mask.height(); ++v) {
    for (int u = 0; u < mask.width(); ++u) mask(u, v) = shown(u, v);
  }
  PointCloud cloud = sample(sphere, 5000, 0);
  std::erase_if(cloud.points, [&](const Eigen::Vector3d& x) {
    const Eigen::Vector2d at = test_camera().project(test_pose().cam_from_world(x));
    return (at - Eigen::Vector2d(60, 44)).norm() > 0.97 * radius_px;
  });
  add_normals(cloud, sphere, 0.05);
  std::mt19937 generator(5);
  std::normal_distribution<double> noise(0, 1.0 * gsd_mm);
  for (Eigen::Vector3d& x : cloud.points) x += Eigen::Vector3d(noise(generator), noise(generator), noise(generator));
  // Errors across the surface, so that the rim has the same weight as the middle.
  double sum = 0, count = 0;
  const DepthPrior prior = project(cloud, {}, mask);
  for (int v = 0; v < mask.height(); ++v) {
    for (int u = 0; u < mask.width(); ++u) {
      if (std::hypot(u - 60, v - 44) > 0.93 * radius_px) continue;
      const double r2 = ((u - 60) * (u - 60) + (v - 44) * (v - 44)) / (radius_px * radius_px);
      sum += std::pow((prior.depth(u, v) - sphere(u, v)) / gsd_mm, 2) * (1 - r2);
      ++count;
    }
  }
  EXPECT_LT(std::sqrt(sum / count), 0.35);
}

TEST(PriorOfCloud, SigmaGrowsAwayFromThePoints) {
  PointCloud cloud = sample(wavy_depth, 4000, 1);
  std::erase_if(cloud.points,
                [](const Eigen::Vector3d& x) { return test_camera().project(test_pose().cam_from_world(x)).x() > 70; });
  PriorOptions options;
  options.correlated_noise = 0;
  const DepthPrior prior = project(cloud, options);
  EXPECT_GT(prior.sigma(110, 45), 3 * prior.sigma(35, 45));
  EXPECT_LT(std::abs(prior.depth(110, 45) - wavy_depth(110, 45)), 5 * prior.sigma(110, 45));
  EXPECT_NEAR(prior.filled_fraction, 0.4, 0.05);
}

TEST(PriorOfCloud, UsesAStatedSigmaAndWarnsIfThePointsContradictIt) {
  const PointCloud cloud = sample(wavy_depth, 2000, 1);
  std::string warning;
  Context context;
  context.on_log = [&warning](LogLevel level, const std::string& message) {
    if (level == LogLevel::warning) warning += message;
  };
  const DepthPrior measured = project(cloud);
  PriorOptions options;
  options.sigma = 2 * gsd_mm;
  const DepthPrior stated = project(cloud, options, full_mask(), context);
  EXPECT_EQ(stated.noise, 2 * gsd_mm);
  EXPECT_TRUE(warning.empty()) << warning;
  const double factor = stated.noise / measured.noise;
  for (std::size_t i = 0; i < stated.depth.count(); ++i) {
    ASSERT_EQ(stated.depth[i], measured.depth[i]);
    ASSERT_NEAR(stated.sigma[i], factor * measured.sigma[i], 1e-5 * stated.sigma[i]);
  }
  options.sigma = 0.1 * gsd_mm;
  project(cloud, options, full_mask(), context);
  expect_contains(warning, "prior cloud: its points scatter by 0.");
  expect_contains(warning, "sigma states 0.05");
}

TEST(PriorOfCloud, AssumesTheSigmaOfPointsThatWereSmoothed) {
  std::string warning;
  Context context;
  context.on_log = [&warning](LogLevel, const std::string& message) { warning += message; };
  const PointCloud smoothed = sample(wavy_depth, 3000, 0.02);
  const DepthPrior prior = project(smoothed, {}, full_mask(), context);
  EXPECT_TRUE(prior.assumes_sigma);
  EXPECT_NEAR(prior.noise, gsd_mm, 0.1 * gsd_mm);
  EXPECT_NEAR(prior.sigma(60, 45), gsd_mm, 0.1 * gsd_mm);
  expect_contains(warning, "prior cloud: its points scatter by only 0.0");
  expect_contains(warning, "a standard deviation of 1 GSD is assumed: state sigma in [prior]");

  EXPECT_TRUE(project(sample(wavy_depth, 16 * 120 * 90, 0.05)).assumes_sigma) << "means of 16 points";

  PriorOptions stated, less_smooth;
  less_smooth.smoothing_px = 0.2;
  EXPECT_FALSE(project(sample(wavy_depth, 10000, 0.5), less_smooth).assumes_sigma);
  stated.sigma = 0.02 * gsd_mm;
  warning.clear();
  EXPECT_FALSE(project(smoothed, stated, full_mask(), context).assumes_sigma);
  EXPECT_EQ(warning, "");
}

TEST(PriorOfCloud, MeansOfManyPointsScatterLittle) {
  // Points four times as dense as the pixels, such as those of photos with smaller pixels, with half of their distance
  // as noise. Their means scatter by less than a tenth of a GSD.
  const DepthPrior prior = project(sample(plane_depth, 16 * 120 * 90, 0.125));
  EXPECT_LT(prior.noise, 0.1 * gsd_mm);
  EXPECT_FALSE(prior.assumes_sigma);
}

TEST(PriorOfCloud, WarnsOfANationalGridInSinglePrecision) {
  std::string warning;
  Context context;
  context.on_log = [&warning](LogLevel, const std::string& message) { warning += message; };
  const auto said = [&](const Eigen::Vector3d& origin, bool single) {
    PointCloud cloud = sample(plane_depth, 500, 0);
    Pose pose = test_pose();
    pose.translation -= pose.rotation * origin;
    for (Eigen::Vector3d& point : cloud.points) {
      point += origin;
      if (single) point = point.cast<float>().cast<double>().eval();
    }
    warning.clear();
    warn_if_rounded(cloud, test_camera(), pose, "prior cloud", context);
    return warning;
  };
  const Eigen::Vector3d grid(4.3e7, 5.4e7, 90);
  expect_contains(said(grid, true), "prior cloud: its coordinates are of single precision, in steps of 4 at 5");
  EXPECT_EQ(said(grid, true).find("e+07"), std::string::npos) << "a number without exponent";
  EXPECT_EQ(said(grid, false), "");
  EXPECT_EQ(said(Eigen::Vector3d::Zero(), true), "");
}

TEST(PriorOfCloud, HiddenPointsAreLeftOut) {
  const auto is_front = [](double u, double) { return u < 60; };
  const Depth front = [](double, double) { return distance_mm; };
  const Depth back = [](double, double) { return 1.2 * distance_mm; };
  PointCloud cloud = sample(back, 3000, 0.1);
  PointCloud nearer = sample(front, 6000, 0.1, 2);
  std::erase_if(nearer.points,
                [](const Eigen::Vector3d& x) { return test_camera().project(test_pose().cam_from_world(x)).x() > 60; });
  add(cloud, nearer);
  const DepthPrior prior = project(cloud);
  // Only pixels away from the edge, where the two surfaces are 160 GSD apart.
  EXPECT_LT(rms_gsd(prior.depth, front, [&](int u, int v) { return is_front(u + 12, v); }), 1);
  EXPECT_LT(rms_gsd(prior.depth, back, [&](int u, int v) { return !is_front(u - 12, v); }), 1);
  EXPECT_NEAR(prior.points_used / prior.points_total, 0.75, 0.03);
}

TEST(PriorOfCloud, PointsFacingAwayAreLeftOut) {
  const Eigen::Vector3f towards = (test_pose().rotation.transpose() * Eigen::Vector3d(0, 0, -1)).cast<float>();
  PointCloud cloud = sample(plane_depth, 2000, 0.1);
  cloud.normals.assign(cloud.points.size(), towards);
  PointCloud away = sample([](double u, double v) { return plane_depth(u, v) - 3 * gsd_mm; }, 2000, 0.1, 5);
  away.normals.assign(away.points.size(), -towards);
  add(cloud, away);
  const DepthPrior prior = project(cloud);
  EXPECT_EQ(prior.points_used, 2000);
  EXPECT_LT(rms_gsd(prior.depth, plane_depth), 0.1);
}

TEST(PriorOfCloud, WarnsOfPatchesWhoseNormalsPointInwards) {
  const Eigen::Vector3f towards = (test_pose().rotation.transpose() * Eigen::Vector3d(0, 0, -1)).cast<float>();
  std::string warning;
  Context context;
  context.on_log = [&warning](LogLevel, const std::string& message) { warning += message; };
  PointCloud cloud = sample(plane_depth, 6000, 0.1);
  cloud.normals.assign(cloud.points.size(), towards);
  // A closed object has points that face away everywhere, but before them others.
  PointCloud closed = cloud;
  PointCloud back = sample([](double u, double v) { return plane_depth(u, v) + 60 * gsd_mm; }, 6000, 0.1, 5);
  back.normals.assign(back.points.size(), -towards);
  add(closed, back);
  project(closed, {}, full_mask(), context);
  EXPECT_EQ(warning, "");
  for (std::size_t i = 0; i < cloud.points.size(); ++i) {
    if (test_camera().project(test_pose().cam_from_world(cloud.points[i])).x() < 30)
      cloud.normals[i] = -cloud.normals[i];
  }
  project(cloud, {}, full_mask(), context);
  expect_contains(warning, "% of the places where it has points all their normals point away from the camera");
}

TEST(PriorOfCloud, ReportsNormalsThatPointInwards) {
  PointCloud cloud = sample(plane_depth, 500, 0.1);
  cloud.normals.assign(cloud.points.size(),
                       (test_pose().rotation.transpose() * Eigen::Vector3d(0, 0, 1)).cast<float>());
  expect_error(
      ErrorCode::data, [&] { project(cloud); }, "500 facing away", "normals point away from the camera");
  // Points that the station does not see say nothing about the normals.
  const Eigen::Vector3d beside = test_pose().world_from_cam(distance_mm * test_camera().ray(1000, 45));
  cloud.points.resize(2000, beside);
  cloud.normals.resize(2000, cloud.normals.front());
  expect_error(
      ErrorCode::data, [&] { project(cloud); }, "1500 outside the image", "normals point away from the camera");
}

TEST(PriorOfCloud, ReportsNormalsThatPointInwardsOfAnObjectWithABack) {
  const Eigen::Vector3f towards = (test_pose().rotation.transpose() * Eigen::Vector3d(0, 0, -1)).cast<float>();
  PointCloud cloud = sample(plane_depth, 2000, 0.1);
  cloud.normals.assign(cloud.points.size(), -towards);
  PointCloud back = sample([](double u, double v) { return plane_depth(u, v) + 60 * gsd_mm; }, 2000, 0.1, 5);
  back.normals.assign(back.points.size(), towards);
  add(cloud, back);
  expect_error(
      ErrorCode::data, [&] { project(cloud); }, "2000 of 4000", "face away", "normals point away from the camera");
  for (Eigen::Vector3f& normal : cloud.normals) normal = -normal;
  EXPECT_LT(rms_gsd(project(cloud).depth, plane_depth), 0.1);
}

TEST(PriorOfCloud, IsNaNOutsideTheMaskOnly) {
  Mask mask = full_mask();
  for (int v = 0; v < 90; ++v) {
    for (int u = 0; u < 120; ++u) mask(u, v) = std::hypot(u - 60, v - 45) < 30;
  }
  const DepthPrior prior = project(sample(plane_depth, 3000, 0.5), {}, mask);
  for (int v = 0; v < 90; ++v) {
    for (int u = 0; u < 120; ++u) {
      ASSERT_EQ(std::isfinite(prior.depth(u, v)), mask(u, v) != 0);
      ASSERT_EQ(std::isfinite(prior.sigma(u, v)), mask(u, v) != 0);
    }
  }
}

TEST(PriorOfCloud, TilesAgreeWithOneSystem) {
  PriorOptions options;
  options.smoothing_px = 2;
  const PointCloud cloud = sample(wavy_depth, 4000, 1);
  const DepthPrior whole = project(cloud, options);
  options.max_unknowns = 1500;
  const DepthPrior tiled = project(cloud, options);
  EXPECT_LT(
      rms_gsd(tiled.depth, [&](double u, double v) { return whole.depth(static_cast<int>(u), static_cast<int>(v)); }),
      0.1);
}

TEST(PriorOfCloud, IsTheSameWithMoreThreads) {
  const PointCloud cloud = sample(wavy_depth, 3000, 1);
  const Context three{.threads = 3};
  const DepthPrior a = project(cloud), b = project(cloud, {}, full_mask(), three);
  for (std::size_t i = 0; i < a.depth.count(); ++i) {
    ASSERT_NEAR(a.depth[i], b.depth[i], 1e-5 * gsd_mm + 1e-4);
    ASSERT_NEAR(a.sigma[i], b.sigma[i], 1e-4 * gsd_mm);
  }
}

TEST(PriorOfCloud, StopsWhenCanceled) {
  const std::atomic<bool> cancel{true};
  Context context;
  context.cancel = &cancel;
  expect_error(ErrorCode::interrupted, [&] { project(sample(plane_depth, 500, 0), {}, full_mask(), context); });
}

TEST(PriorOfCloud, ReportsWherePointsThatMissTheObjectLie) {
  PointCloud cloud;
  for (int i = 0; i < 7; ++i) cloud.points.push_back(test_pose().world_from_cam({0, 0, -10}));
  for (int i = 0; i < 5; ++i) cloud.points.push_back(test_pose().world_from_cam({1000, 0, 100}));
  expect_error(
      ErrorCode::data, [&] { project(cloud); }, "0 of 12 points", "7 behind", "5 outside the image");
}

TEST(PriorOfCloud, RejectsUnusableInput) {
  PointCloud cloud = sample(plane_depth, 500, 0);
  cloud.points[3].y() = std::numeric_limits<double>::quiet_NaN();
  expect_error(
      ErrorCode::input, [&] { project(cloud); }, "point 3");

  cloud = sample(plane_depth, 500, 0);
  cloud.normals.resize(2);
  expect_error(
      ErrorCode::input, [&] { project(cloud); }, "2 normals");
  cloud.normals.clear();
  expect_error(
      ErrorCode::input,
      [&] {
        project(cloud, {}, Mask({3, 2}, 1, 1));
      },
      "3 x 2");
  expect_error(
      ErrorCode::input, [&] { project(cloud, {}, Mask(test_camera().size)); }, "no pixel");
  PriorOptions options;
  options.neighbors = 1;
  expect_error(
      ErrorCode::input, [&] { project(cloud, options); }, "prior.neighbors = 1");
  expect_error(
      ErrorCode::data, [] { project(sample(plane_depth, 20, 0)); }, "20 of 20 points are visible", "too few points");
  Pose pose = test_pose();
  pose.translation.x() = std::numeric_limits<double>::infinity();
  expect_error(ErrorCode::input, [&] { project_prior(cloud, test_camera(), pose, full_mask(), {}, {}); });
}

/// Two triangles that show the tilted plane in columns [u0, u1] and all rows, its depth multiplied by `nearer`.
TriangleMesh plane_mesh(double u0, double u1, double nearer) {
  TriangleMesh mesh;
  for (const auto& [u, v] : {std::pair(u0, -5.0), std::pair(u1, -5.0), std::pair(u0, 95.0), std::pair(u1, 95.0)}) {
    mesh.vertices.points.push_back(test_pose().world_from_cam(nearer * plane_depth(u, v) * test_camera().ray(u, v)));
  }
  mesh.triangles = {{0, 1, 2}, {1, 3, 2}};
  return mesh;
}

TEST(PriorOfMesh, IsExactInPerspectiveAndTakesTheNearestTriangle) {
  TriangleMesh mesh = plane_mesh(-5, 125, 1);
  const TriangleMesh nearer = plane_mesh(80.5, 125, 0.9);
  mesh.vertices.points.insert(mesh.vertices.points.end(), nearer.vertices.points.begin(), nearer.vertices.points.end());
  mesh.triangles.push_back({5, 4, 6});
  mesh.triangles.push_back({5, 6, 7});
  const DepthPrior prior = project(mesh);
  EXPECT_LT(rms_gsd(prior.depth, [](double u, double v) { return plane_depth(u, v) * (u > 80 ? 0.9 : 1.0); }), 1e-3);
  EXPECT_EQ(prior.filled_fraction, 0);
}

TEST(PriorOfMesh, HasTheAssumedOrTheStatedNoise) {
  PriorOptions options;
  options.raster_sigma_gsd = 3;
  const DepthPrior assumed = project(plane_mesh(-5, 125, 1), options);
  const double gsd = assumed.depth(60, 45) / focal;
  EXPECT_NEAR(assumed.sigma(60, 45), 3 * gsd, 1e-5);
  EXPECT_NEAR(assumed.noise, 3 * gsd, 0.1 * gsd) << "the noise of the middle pixel";
  EXPECT_GT(assumed.spacing_px, 1) << "errors of neighboring pixels are correlated";
  options.sigma = 0.7;
  const DepthPrior stated = project(plane_mesh(-5, 125, 1), options);
  EXPECT_FLOAT_EQ(static_cast<float>(stated.noise), 0.7F);
  for (const float sigma : stated.sigma) ASSERT_EQ(sigma, 0.7F);
}

TEST(PriorOfMesh, RejectsInvalidIndicesAndAMeshOutsideTheView) {
  TriangleMesh mesh = plane_mesh(-5, 125, 1);
  mesh.triangles.push_back({0, 1, 9});
  expect_error(
      ErrorCode::input, [&] { project(mesh); }, "triangle 2 names vertex 9");
  expect_error(ErrorCode::data, [&] { project(plane_mesh(500, 600, 1)); });
}

/// World point of the prior at a pixel.
Eigen::Vector3d world_point(const DepthPrior& prior, int u, int v) {
  return prior.pose.world_from_cam(prior.depth(u, v) * test_camera().ray(u, v));
}

TEST(PriorOfShape, IsThePlaneSphereOrCylinder) {
  const Eigen::Vector3d axis(1, 0.2, -0.3), center = test_pose().world_from_cam({4, -3, 500});
  const PlaneShape plane{center, {0.1, 0.2, -3}};
  const SphereShape sphere{center, 120};
  const CylinderShape cylinder{center, axis, 110};
  PriorOptions options;
  options.sigma = 0.3;
  const DepthPrior of_plane = project(Shape(plane), options), of_sphere = project(Shape(sphere), options),
                   of_cylinder = project(Shape(cylinder), options);
  for (const auto& [u, v] : {std::pair(0, 0), {60, 44}, {119, 89}, {100, 10}}) {
    EXPECT_NEAR((world_point(of_plane, u, v) - center).dot(plane.normal.normalized()), 0, 1e-3);
    EXPECT_NEAR((world_point(of_sphere, u, v) - center).norm(), 120, 1e-3);
    EXPECT_NEAR((world_point(of_cylinder, u, v) - center).cross(axis.normalized()).norm(), 110, 1e-3);
    EXPECT_LT(of_sphere.depth(u, v), 500) << "the near side of the sphere";
    EXPECT_LT(of_cylinder.depth(u, v), 500);
  }
  EXPECT_EQ(of_sphere.sigma(60, 44), 0.3F);
  EXPECT_EQ(of_sphere.noise, 0) << "the deviation of the object from the shape does not average out";
  EXPECT_EQ(of_sphere.filled_fraction, 0);
}

TEST(PriorOfShape, IsSeenFromInsideAndFilledBesideIt) {
  const Eigen::Vector3d eye = test_pose().center();
  PriorOptions options;
  options.sigma = 0.3;
  const DepthPrior inside = project(Shape(SphereShape{eye, 200}), options);
  EXPECT_NEAR((world_point(inside, 30, 70) - eye).norm(), 200, 1e-3);
  // A sphere that covers only the middle of the image.
  const DepthPrior small = project(Shape(SphereShape{test_pose().world_from_cam({0, 0, 400}), 15}), options);
  EXPECT_GT(small.filled_fraction, 0.5);
  for (const float depth : small.depth) ASSERT_TRUE(std::isfinite(depth));
  expect_error(
      ErrorCode::data,
      [&] {
        project(Shape(PlaneShape{test_pose().world_from_cam({0, 0, -50}), test_pose().rotation.row(2).transpose()}),
                options);
      },
      "prior plane: 0 object pixels have a depth");
}

TEST(PriorOfShape, NeedsItsDistanceFromTheObject) {
  expect_error(
      ErrorCode::input,
      [&] {
        project(Shape(SphereShape{test_pose().world_from_cam({0, 0, 400}), 90}));
      },
      "prior sphere: sigma is missing", "how far the object is");
}

TEST(PriorOfDepthMap, KeepsPixelsAndFillsHoles) {
  Image<float> depth(test_camera().size);
  for (int v = 0; v < 90; ++v) {
    for (int u = 0; u < 120; ++u) depth(u, v) = static_cast<float>(plane_depth(u, v));
  }
  const auto in_hole = [](int u, int v) { return std::hypot(u - 50, v - 40) < 6; };
  for (int v = 0; v < 90; ++v) {
    for (int u = 0; u < 120; ++u) {
      if (in_hole(u, v)) depth(u, v) = (u + v) % 2 == 0 ? std::numeric_limits<float>::quiet_NaN() : 0.0F;
    }
  }
  const DepthPrior prior = project(depth);
  for (int v = 0; v < 90; ++v) {
    for (int u = 0; u < 120; ++u) {
      if (!in_hole(u, v)) {
        ASSERT_EQ(prior.depth(u, v), depth(u, v));
      }
    }
  }
  EXPECT_LT(rms_gsd(prior.depth, plane_depth, in_hole), 0.02);
  EXPECT_GT(prior.filled_fraction, 0);
  // The middle of the hole is about five pixels from the nearest depth; the standard slope is 1.
  const double gsd = prior.depth(50, 40) / focal;
  EXPECT_GT(prior.sigma(50, 40), 5 * gsd) << "unseen parts may deviate from their surroundings";
  EXPECT_LT(prior.sigma(50, 40), 8 * gsd);
  EXPECT_NEAR(prior.noise, prior.depth(60, 45) / focal, 0.1 * gsd) << "what is closed is no noise";
  EXPECT_TRUE(prior.assumes_sigma);
}

TEST(PriorOfDepthMap, LargeNumbersForNoDepthAreHoles) {
  for (const float number : {3.4028235e38F, 1e6F, 65535.0F}) {
    Image<float> depth(test_camera().size);
    for (int v = 0; v < 90; ++v) {
      for (int u = 0; u < 120; ++u)
        depth(u, v) = std::hypot(u - 50, v - 40) < 6 ? number : static_cast<float>(plane_depth(u, v));
    }
    std::string said;
    Context context;
    context.on_log = [&](LogLevel, const std::string& message) { said += message; };
    const DepthPrior prior = project_prior(depth, test_camera(), test_pose(), full_mask(), {}, context);
    EXPECT_LT(rms_gsd(prior.depth, plane_depth), 0.02) << number;
    EXPECT_GT(prior.filled_fraction, 0) << number;
    EXPECT_NE(said.find("taken as pixels without a depth"), std::string::npos) << said;
  }
  // The far part of an object that reaches far back is a part of it.
  Image<float> deep(test_camera().size);
  for (int v = 0; v < 90; ++v) {
    for (int u = 0; u < 120; ++u) deep(u, v) = u < 60 ? 400.0F : 1000.0F;
  }
  EXPECT_EQ(project(deep).depth(100, 40), 1000.0F);
}

TEST(PriorOfCloud, MayLieExactlyInAPlaneParallelToTheSensor) {
  PointCloud cloud;
  for (int v = 1; v < 90; v += 3)
    for (int u = 1; u < 120; u += 3) cloud.points.push_back(50 * test_camera().ray(u, v));
  const DepthPrior prior = project_prior(cloud, test_camera(), Pose{}, full_mask(), {}, {});
  EXPECT_NEAR(prior.depth(60, 45), 50, 1e-5);
  EXPECT_GT(prior.sigma(60, 45), 0);
}

TEST(PriorOfDepthMap, FillsHolesOfAPlaneParallelToTheSensor) {
  Image<float> depth(test_camera().size, 1, 50.0F);
  depth(50, 40) = depth(51, 40) = std::numeric_limits<float>::quiet_NaN();
  const DepthPrior prior = project(depth);
  EXPECT_EQ(prior.depth(50, 40), 50.0F);
  EXPECT_GT(prior.sigma(50, 40), 0);
}

TEST(PriorOfDepthMap, SmoothsDepthsThatWereMeasuredOverWindows) {
  // Noise that is correlated over windows of 5 px, and gaps.
  const Size size = test_camera().size;
  std::mt19937 generator(4);
  std::normal_distribution<double> normal(0, 5 * gsd_mm);
  Image<double> noise({size.width + 4, size.height + 4});
  for (double& value : noise) value = normal(generator);
  Image<float> depth(size), sigma(size, 1, static_cast<float>(gsd_mm));
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      double mean = 0;
      for (int k = 0; k < 25; ++k) mean += noise(u + k % 5, v + k / 5) / 25;
      depth(u, v) = static_cast<float>(plane_depth(u, v) + mean);
      if (std::hypot(u - 50, v - 40) < 6) sigma(u, v) = std::numeric_limits<float>::quiet_NaN();
    }
  }
  const double before = rms_gsd(depth, plane_depth);
  const DepthPrior prior = project_prior({depth, sigma, {}}, test_camera(), test_pose(), full_mask(), {}, {});
  EXPECT_NEAR(before, 1, 0.1);
  EXPECT_LT(rms_gsd(prior.depth, plane_depth), 0.5 * before);
  EXPECT_GE(prior.sigma(5, 5), sigma(5, 5));
  // (50, 40) is the center of a hole of radius 6, about five pixels from the nearest depth; the standard slope is 1.
  EXPECT_GT(prior.sigma(50, 40), 5 * gsd_mm);
  EXPECT_LT(prior.sigma(50, 40), 8 * gsd_mm);
  EXPECT_FALSE(prior.assumes_sigma) << "a sweep states its errors";
  expect_error(
      ErrorCode::data,
      [&] {
        const Image<float> nowhere(size, 1, std::numeric_limits<float>::quiet_NaN());
        project_prior({nowhere, nowhere, {}}, test_camera(), test_pose(), full_mask(), {}, {});
      },
      "agree nowhere");
  expect_error(ErrorCode::input, [&] {
    project_prior({depth, Image<float>({3, 3}), {}}, test_camera(), test_pose(), full_mask(), {}, {});
  });
}

TEST(PriorOfDepthMap, TakesTheVisualHullWhereTheSweepHasNoDepth) {
  const Size size = test_camera().size;
  constexpr float none = std::numeric_limits<float>::quiet_NaN();
  SweptDepth swept{Image<float>(size), Image<float>(size, 1, static_cast<float>(gsd_mm)), {}};
  swept.hull = Image<float>(size);
  swept.hull_sigma = Image<float>(size, 1, static_cast<float>(6 * gsd_mm));
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      // The sweep knows the left half, the hull all but some rows; there the sweep is right, the hull 3 GSD nearer.
      swept.depth(u, v) = u < size.width / 2 ? static_cast<float>(plane_depth(u, v)) : none;
      swept.hull(u, v) = v < size.height - 8 ? static_cast<float>(plane_depth(u, v) - 3 * gsd_mm) : none;
    }
  }
  const DepthPrior prior = project_prior(swept, test_camera(), test_pose(), full_mask(), {}, {});
  EXPECT_NEAR(prior.depth(10, 20), plane_depth(10, 20), 0.5 * gsd_mm);
  EXPECT_NEAR(prior.depth(size.width - 10, 20), plane_depth(size.width - 10, 20) - 3 * gsd_mm, gsd_mm);
  EXPECT_LT(prior.sigma(10, 20), 2 * gsd_mm);
  EXPECT_GE(prior.sigma(size.width - 10, 20), 5.9 * gsd_mm);
  EXPECT_NEAR(prior.hull_fraction, 0.5 * (size.height - 8) / size.height, 0.01);
  EXPECT_NEAR(prior.filled_fraction, 0.5 * 8 / size.height, 0.01);
  swept.hull_sigma = Image<float>({3, 3});
  expect_error(
      ErrorCode::input, [&] { project_prior(swept, test_camera(), test_pose(), full_mask(), {}, {}); }, "visual hull");
}

TEST(PriorOfDepthMap, AHullThatGivesMostDepthsIsNotSmoothedAboutASurfaceEither) {
  const Size size = test_camera().size;
  constexpr float none = std::numeric_limits<float>::quiet_NaN();
  SweptDepth swept{Image<float>(size, 1, none), Image<float>(size, 1, none), {}};
  swept.hull = Image<float>(size);
  swept.hull_sigma = Image<float>(size, 1, static_cast<float>(6 * gsd_mm));
  const auto wavy = [](int u, int v) { return plane_depth(u, v) - 3 * gsd_mm * std::sin(0.3 * u); };
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      swept.hull(u, v) = static_cast<float>(wavy(u, v));
      if (u < size.width / 4) swept.depth(u, v) = static_cast<float>(wavy(u, v) + 0.2 * gsd_mm);
      if (u < size.width / 4) swept.sigma(u, v) = static_cast<float>(gsd_mm);
    }
  }
  const DepthPrior first = project_prior(swept, test_camera(), test_pose(), full_mask(), {}, {});
  swept.shape = first.depth;
  const DepthPrior second = project_prior(swept, test_camera(), test_pose(), full_mask(), {}, {});
  EXPECT_EQ(first.smoothing_px, 0);
  EXPECT_EQ(second.smoothing_px, 0) << "sigma would count the form of the hull as detail that smoothing removed";
  EXPECT_NEAR(second.noise, first.noise, 0.5 * gsd_mm) << "the hull's sigma is no noise of points";
  EXPECT_LT(rms_gsd(second.depth, wavy), 1);
}

TEST(PriorOfDepthMap, UsesNoFinerCellsThanItsPointsSupport) {
  // Without noise there is hardly any smoothing. Cells of one pixel would mean 10 800 unknowns, which would have to be
  // solved in tiles.
  const Size size = test_camera().size;
  Image<float> depth(size), sigma(size, 1, static_cast<float>(0.1 * gsd_mm));
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) depth(u, v) = static_cast<float>(wavy_depth(u, v));
  }
  PriorOptions options;
  options.max_unknowns = 4000;
  int tiles = 0;
  Context context;
  context.on_progress = [&](const Progress& progress) { tiles += progress.fraction > 0.3 && progress.fraction < 1; };
  const DepthPrior prior = project_prior({depth, sigma, {}}, test_camera(), test_pose(), full_mask(), options, context);
  EXPECT_LT(prior.smoothing_px, 2);
  EXPECT_EQ(tiles, 0);
  EXPECT_LT(rms_gsd(prior.depth, wavy_depth), 0.1);
}

TEST(PriorOfDepthMap, FillsHolesWithTheShapeItWasMeasuredAbout) {
  // A bulge where stereo has no depth, and a shape with a wrong tilt.
  const auto bulge = [](double u, double v) { return -6 * gsd_mm * std::exp(-(std::hypot(u - 50, v - 40) / 8)); };
  const auto truth = [&](double u, double v) { return plane_depth(u, v) + bulge(u, v); };
  const Size size = test_camera().size;
  SweptDepth swept{Image<float>(size), Image<float>(size, 1, static_cast<float>(0.2 * gsd_mm)), Image<float>(size)};
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      swept.depth(u, v) = static_cast<float>(truth(u, v));
      swept.shape(u, v) = static_cast<float>(truth(u, v) + 0.03 * gsd_mm * u);
      if (std::hypot(u - 50, v - 40) < 12) swept.depth(u, v) = std::numeric_limits<float>::quiet_NaN();
    }
  }
  const auto project_swept = [&] { return project_prior(swept, test_camera(), test_pose(), full_mask(), {}, {}); };
  const DepthPrior with_shape = project_swept();
  EXPECT_TRUE(with_shape.shares_windows);
  EXPECT_NEAR(with_shape.noise, 0.2 * gsd_mm, 0.05 * gsd_mm) << "the stated one: depths in a plane hardly scatter";
  EXPECT_NEAR(with_shape.filled_fraction, 12 * 12 * 3.14159 / static_cast<double>(swept.depth.count()), 0.005);
  EXPECT_LT(rms_gsd(with_shape.depth, truth), 0.1);
  EXPECT_NEAR(with_shape.depth(50, 40), truth(50, 40), 0.3 * gsd_mm);
  swept.shape(3, 3) = std::numeric_limits<float>::quiet_NaN();
  expect_error(ErrorCode::input, project_swept);
  swept.shape = {};
  EXPECT_GT(std::abs(project_swept().depth(50, 40) - truth(50, 40)), gsd_mm);
}

TEST(PriorOfDepthMap, RejectsOtherSizesAndEmptyMaps) {
  expect_error(ErrorCode::input, [] { project(Image<float>({10, 10}, 1, 400.0F)); });
  expect_error(
      ErrorCode::input, [] { project(Image<float>(test_camera().size, 3, 400.0F)); }, "has 3 channels, expected 1");
  expect_error(ErrorCode::data, [] { project(Image<float>(test_camera().size)); });
}

}  // namespace
}  // namespace malus
