#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <vector>

#include "height/height_scenes.h"
#include "malus/core/depth_normals_internal.h"
#include "malus/height/height_internal.h"
#include "malus/lighting/light_from_polarization_internal.h"

namespace malus {
namespace {

using namespace height_scenes;

/// Mean angle between the true normals and the normals from the height's central differences, in degrees.
double normal_error(const Scene& scene, const HeightMap& map) {
  double sum = 0;
  int count = 0;
  for (int v = 1; v + 1 < map.height.height(); ++v) {
    for (int u = 1; u + 1 < map.height.width(); ++u) {
      const double hu = 0.5 * (map.height(u + 1, v) - map.height(u - 1, v));
      const double hv = 0.5 * (map.height(u, v + 1) - map.height(u, v - 1));
      if (!std::isfinite(hu + hv)) continue;
      const Eigen::Vector3d n(scene.normals(u, v, 0), scene.normals(u, v, 1), scene.normals(u, v, 2));
      sum += std::acos(std::min(Eigen::Vector3d(-hu, -hv, -1).normalized().dot(n), 1.0)) / degree;
      ++count;
    }
  }
  return sum / count;
}

/// Scale of the solved height relative to the true one, both about their means (least squares).
double height_scale(const Scene& scene, const HeightMap& map) {
  double mean = 0, top = 0, bottom = 0;
  int count = 0;
  for (std::size_t i = 0; i < scene.truth.count(); ++i) {
    if (!std::isfinite(scene.truth[i])) continue;
    mean += scene.truth[i];
    ++count;
  }
  mean /= count;
  for (std::size_t i = 0; i < scene.truth.count(); ++i) {
    if (!std::isfinite(scene.truth[i])) continue;
    top += (scene.truth[i] - mean) * map.height[i];
    bottom += (scene.truth[i] - mean) * (scene.truth[i] - mean);
  }
  return top / bottom;
}

/// RMS difference between two heights, px.
double rms_difference(const HeightMap& a, const HeightMap& b) {
  double squares = 0, count = 0;
  for (std::size_t i = 0; i < a.height.count(); ++i) {
    if (!std::isfinite(a.height[i])) continue;
    squares += (a.height[i] - b.height[i]) * (a.height[i] - b.height[i]);
    ++count;
  }
  return std::sqrt(squares / count);
}

/// The scene's light as if it had been estimated.
LightEstimate known_light(const Scene& scene, const Pinhole* rays = nullptr) {
  LightEstimate light;
  light.coefficients = scene.light;
  judge_direction(light, rays, scene.state.size(), {});
  return light;
}

/// The light by these normals, for parallel rays.
LightEstimate light_by(const Image<float>& normals, const Scene& scene) {
  return estimate_light(scene.state.i_un, normals, scene.state.valid_pixels(), nullptr, {}, {});
}

HeightMap solve(const Scene& scene, const HeightOptions& options = {}, const Pinhole* camera = nullptr,
                const Context& context = {}) {
  const LightEstimate light = known_light(scene, options.perspective ? camera : nullptr);
  return solve_height({scene.state, scene.reflection, camera, light, nullptr}, options, context);
}

/// The height for parallel rays with this light.
HeightMap solve_with(const LightEstimate& light, const Scene& scene) {
  return solve_height({scene.state, scene.reflection, nullptr, light, nullptr}, {}, {});
}

const Eigen::Vector4d light_right(0.2747, 0, -0.9615, 0);
const Eigen::Vector4d light_above(0, -0.5, -0.866, 0);

TEST(Height, ExactWithoutNoise) {
  for (const auto& light : {light_right, light_above}) {
    const Scene round = render(sphere(128), {128, 128}, nullptr, light, 0);
    const HeightMap map = solve(round);
    EXPECT_EQ(map.status, HeightStatus::converged);
    EXPECT_LT(normal_error(round, map), 0.05);
    EXPECT_NEAR(height_scale(round, map), 1, 1e-3);
    const Scene relief = render(bumps(128), {128, 128}, nullptr, light, 0);
    EXPECT_LT(normal_error(relief, solve(relief)), 0.2);  // central differences of the true height already give 0.15
  }
}

TEST(Height, IsAccurateWithNoise) {
  for (const auto& light : {light_right, light_above}) {
    for (const auto& surface : {sphere(128), bumps(128)}) {
      const Scene scene = render(surface, {128, 128}, nullptr, light, 0.005);
      const HeightMap map = solve(scene);
      EXPECT_LT(normal_error(scene, map), 2.0);
      EXPECT_NEAR(height_scale(scene, map), 1, 0.02);
      EXPECT_NEAR(map.residual_rms, 1, 0.4);
    }
  }
}

TEST(Height, LiteralMethodIsExactWithoutNoiseAndWorstWithNoise) {
  HeightOptions literal, linear;
  literal.method = HeightMethod::literal;
  linear.method = HeightMethod::linear;
  const Scene clean = render(sphere(96), {96, 96}, nullptr, light_right, 0);
  EXPECT_LT(normal_error(clean, solve(clean, literal)), 0.05);
  const Scene noisy = render(bumps(96), {96, 96}, nullptr, light_right, 0.005);
  const double error_literal = normal_error(noisy, solve(noisy, literal));
  const double error_linear = normal_error(noisy, solve(noisy, linear));
  EXPECT_LT(error_linear, error_literal);
  EXPECT_LT(normal_error(noisy, solve(noisy)), error_linear);
}

TEST(Height, SolvesSpecularReflection) {
  const Scene scene = render(sphere(96), {96, 96}, nullptr, light_right, 0.002, Reflection::specular);
  const HeightMap map = solve(scene);
  EXPECT_LT(normal_error(scene, map), 0.5);
  EXPECT_NEAR(height_scale(scene, map), 1, 0.01);
}

TEST(Height, OrthographicHeightAllowsForTheShapeOfPixels) {
  const Pinhole camera{{120, 120}, 1100, 900, 60, 60};
  const double radius = 50;
  const Surface dome = [&](int u, int v, double& height, Eigen::Vector3d& normal) {
    const double x = (u - camera.cx) * camera.focal() / camera.fx, y = (v - camera.cy) * camera.focal() / camera.fy;
    const double z2 = radius * radius - x * x - y * y;
    if (z2 < 0.25 * radius * radius) return false;
    height = std::sqrt(z2);
    normal = Eigen::Vector3d(x, y, -height) / radius;
    return true;
  };
  const Scene scene = render(dome, camera.size, nullptr, light_right, 0);
  HeightOptions options;
  options.perspective = false;
  const HeightMap map = solve(scene, options, &camera);
  EXPECT_EQ(map.status, HeightStatus::converged);
  EXPECT_FALSE(map.perspective);
  double sum = 0, squares = 0, count = 0;
  for (std::size_t i = 0; i < scene.truth.count(); ++i) {
    const double error = static_cast<double>(map.height[i]) - scene.truth[i];
    if (!std::isfinite(error)) continue;
    sum += error;
    squares += error * error;
    count += 1;
  }
  EXPECT_LT(std::sqrt(squares / count - sum * sum / (count * count)), 0.3);
}

TEST(Height, PerspectiveHeightIsTheMetricSurface) {
  const Pinhole camera{{110, 100}, 400, 400, 30, 62};
  const Eigen::Vector4d light(0.3, -0.2, -0.8, 0.05);
  const Scene scene = render(ball(camera, 70), camera.size, &camera, light, 0);
  const HeightMap map = solve(scene, {}, &camera);
  EXPECT_EQ(map.status, HeightStatus::converged);
  EXPECT_TRUE(map.perspective);
  EXPECT_NEAR(height_scale(scene, map), 1, 2e-3);
  Image<float> depth(camera.size);
  for (std::size_t i = 0; i < depth.count(); ++i) {
    depth[i] = static_cast<float>(600 * std::exp(-map.height[i] / camera.focal()));
  }
  const Image<float> normals = normals_from_depth(depth, camera, {});
  double sum = 0;
  int count = 0;
  for (int v = 2; v < 98; ++v) {
    for (int u = 2; u < 108; ++u) {
      if (!std::isfinite(depth(u - 1, v) + depth(u + 1, v) + depth(u, v - 1) + depth(u, v + 1))) continue;
      double dot = 0;
      for (int c = 0; c < 3; ++c) dot += normals(u, v, c) * scene.normals(u, v, c);
      sum += std::acos(std::min(dot, 1.0)) / degree;
      ++count;
    }
  }
  EXPECT_GT(count, 1000);
  EXPECT_LT(sum / count, 0.1);
}

TEST(Height, LightIsEstimatedWithThePriorsNormals) {
  const Scene scene = render(bumps(96), {96, 96}, nullptr, light_right, 0.005);
  const HeightMap map = solve_with(light_by(scene.normals, scene), scene);
  EXPECT_LT((map.light - light_right).norm(), 0.01);
  EXPECT_LT(normal_error(scene, map), 2.5);
}

TEST(Height, NeedsNoPriorForAConvexObject) {
  const Eigen::Vector4d oblique(0.3, 0.2, -0.6, 0);
  for (const double noise : {0.0, 0.003}) {
    const Scene scene = render(sphere(128), {128, 128}, nullptr, oblique, noise);
    const HeightMap map =
        solve_with(light_from_polarization(scene.state, scene.reflection, std::nullopt, nullptr, {}, {}), scene);
    EXPECT_EQ(map.status, HeightStatus::converged);
    const Eigen::Vector3d light = map.light.head<3>();
    EXPECT_LT(std::acos(light.normalized().dot(oblique.head<3>().normalized())) / degree, noise > 0 ? 3 : 1);
    EXPECT_NEAR(light.norm() / oblique.head<3>().norm(), 1, 0.03);
    EXPECT_LT(normal_error(scene, map), noise > 0 ? 3 : 1);
  }
}

/// Angle between the estimated and the true light [°].
double light_error(const LightEstimate& light, const Eigen::Vector4d& truth) {
  const Eigen::Vector3d found = light.coefficients.head<3>(), right = truth.head<3>();
  return std::acos(std::clamp(found.normalized().dot(right.normalized()), -1.0, 1.0)) / degree;
}

LightOptions assuming(LightWithoutPrior assumption) {
  LightOptions options;
  options.without_prior = assumption;
  return options;
}

TEST(Height, EstimatesLightFromTheOutlineOfABall) {
  const Pinhole camera{{160, 120}, 700, 700, 79.5, 59.5};
  const Eigen::Vector4d oblique(0.3, 0.25, -0.6, 0);
  for (const double noise : {0.0, 0.003}) {
    const Scene scene = render(ball(camera, 45), camera.size, &camera, oblique, noise);
    const LightEstimate light = light_from_polarization(scene.state, scene.reflection, std::nullopt, &camera,
                                                        assuming(LightWithoutPrior::contour), {});
    EXPECT_EQ(light.status, LightStatus::estimated);
    EXPECT_TRUE(light.of_contour);
    EXPECT_LT(light_error(light, oblique), noise > 0 ? 1.5 : 0.01);
    EXPECT_NEAR(light.coefficients.head<3>().norm() / oblique.head<3>().norm(), 1, noise > 0 ? 0.03 : 0.003);
  }
}

TEST(Height, TheOutlineDistinguishesAHollowLidFromABump) {
  // Most of the lid slopes inwards: taken as convex, it appears lit from the other side.
  const Eigen::Vector4d oblique(0.3, 0.25, -0.6, 0);
  const Scene scene = render(dish(200), {200, 200}, nullptr, oblique, 0.002);
  const auto found = [&](LightWithoutPrior assumption) {
    return light_from_polarization(scene.state, scene.reflection, std::nullopt, nullptr, assuming(assumption), {});
  };
  const LightEstimate light = found(LightWithoutPrior::contour);
  EXPECT_TRUE(light.of_contour);
  EXPECT_LT(light_error(light, oblique), 2);
  EXPECT_LT(light_error(found(LightWithoutPrior::convex), {-0.3, -0.25, -0.6, 0}), 2);
  EXPECT_LT(normal_error(scene, solve_with(light, scene)), 3);
}

TEST(Height, ABorderThatIsNoOccludingContourIsNotUsed) {
  // Bumps cut off by a straight edge, and bumps that fill the image.
  for (const Size size : {Size{96, 96}, Size{88, 88}}) {
    const Surface whole = [](int u, int v, double& height, Eigen::Vector3d& normal) {
      return bumps(96)(u + 4, v + 4, height, normal);
    };
    const Scene scene = render(size.width == 96 ? bumps(96) : whole, size, nullptr, light_right, 0.002);
    const LightEstimate light = light_from_polarization(scene.state, scene.reflection, std::nullopt, nullptr, {}, {});
    EXPECT_FALSE(light.of_contour);
    EXPECT_EQ(light.status, LightStatus::estimated);
  }
}

TEST(Height, WithAKnownDirectionOnlyTheStrengthIsEstimated) {
  // Bumps are neither convex nor hollow: only the known direction resolves the ambiguity between the two.
  const Eigen::Vector4d oblique(0.35, -0.2, -0.6, 0);
  const Scene scene = render(bumps(128), {128, 128}, nullptr, oblique, 0.002);
  const LightEstimate light =
      light_from_polarization(scene.state, scene.reflection, Eigen::Vector3d(2 * oblique.head<3>()), nullptr, {}, {});
  EXPECT_EQ(light.status, LightStatus::estimated);
  EXPECT_LT((light.coefficients - oblique).norm(), 0.02);
  EXPECT_LT(normal_error(scene, solve_with(light, scene)), 2.5);
}

TEST(Height, BridgesPixelsWithoutPolarization) {
  Scene scene = render(sphere(96), {96, 96}, nullptr, light_right, 0);
  for (int v = 40; v < 46; ++v) {
    for (int u = 60; u < 66; ++u) {
      scene.state.valid(u, v) = static_cast<std::uint8_t>(PixelState::saturated);
      scene.reflection.label(u, v) = 0;
    }
  }
  const HeightMap map = solve(scene);
  EXPECT_TRUE(std::isfinite(map.height(62, 43)));
  EXPECT_TRUE(std::isnan(map.height(0, 0)));
  EXPECT_LT(normal_error(scene, map), 0.2);
}

TEST(Height, PriorFixesTheHeightAtTheBorder) {
  const Scene scene = render(sphere(64), {64, 64}, nullptr, light_right, 0);
  HeightOptions options;
  options.boundary = HeightBoundary::prior;
  HeightInput input{scene.state, scene.reflection, nullptr, known_light(scene), &scene.truth};
  const HeightMap map = solve_height(input, options, {});
  for (std::size_t i = 0; i < map.height.count(); ++i) {
    if (!std::isfinite(map.height[i])) continue;
    EXPECT_NEAR(map.height[i], scene.truth[i], 0.05);
  }
  input.prior_height = nullptr;
  EXPECT_THROW(solve_height(input, options, {}), Error);
}

TEST(Height, StartsFromAPriorThatHasHoles) {
  // With this noise the linear solutions are poor starts.
  const Scene scene = render(bumps(96), {96, 96}, nullptr, light_right, 0.02);
  Image<float> holes = scene.truth;
  for (int v = 40; v < 46; ++v)
    for (int u = 50; u < 56; ++u) holes(u, v) = none;
  const auto from = [&](const Image<float>* prior) {
    return solve_height({scene.state, scene.reflection, nullptr, known_light(scene), prior}, {}, {});
  };
  const HeightMap whole = from(&scene.truth);
  EXPECT_LT(rms_difference(from(&holes), whole), 0.2 * rms_difference(from(nullptr), whole));
}

TEST(Height, IsComparedWithThePriorInSize) {
  const Scene scene = render(sphere(64), {64, 64}, nullptr, light_right, 0);
  Image<float> flatter = scene.truth;
  for (float& value : flatter) value *= 0.25F;
  EXPECT_NEAR(solve_height({scene.state, scene.reflection, nullptr, known_light(scene), &flatter}, {}, {}).over_prior,
              4, 0.05);
  EXPECT_EQ(solve(scene).over_prior, 0);
}

TEST(Height, LightAlongTheViewGivesAStatusAndNoHeight) {
  const Scene scene = render(sphere(64), {64, 64}, nullptr, {0, 0, -1, 0}, 0.005);
  const HeightMap map = solve(scene);
  EXPECT_EQ(map.status, HeightStatus::light_along_view);
  for (const float value : map.height) EXPECT_TRUE(std::isnan(value));
}

TEST(Height, OtherFailuresGiveAStatus) {
  Scene scene = render(sphere(64), {64, 64}, nullptr, light_right, 0);
  Image<float> flat(scene.state.size(), 3);
  for (std::size_t i = 0; i < flat.count(); i += 3) flat[i + 2] = -1;
  EXPECT_EQ(solve_with(light_by(flat, scene), scene).status, HeightStatus::normals_too_alike_for_light);
  HeightOptions options;
  options.iterations = 1;
  options.tolerance = 0;
  EXPECT_EQ(solve(scene, options).status, HeightStatus::iteration_limit);
  scene.state.valid.fill(0);
  EXPECT_EQ(solve(scene).status, HeightStatus::no_valid_pixels);
}

TEST(Height, InputErrorsAndCancellation) {
  const Scene scene = render(sphere(32), {32, 32}, nullptr, light_right, 0);
  HeightOptions options;
  options.smoothness = -1;
  EXPECT_THROW(solve(scene, options), Error);
  const Image<float> small({3, 3});
  const HeightInput input{scene.state, scene.reflection, nullptr, known_light(scene), &small};
  EXPECT_THROW(solve_height(input, {}, {}), Error);
  std::atomic<bool> cancel{true};
  Context context;
  context.cancel = &cancel;
  EXPECT_THROW(solve(scene, {}, nullptr, context), Error);
}

TEST(Height, SameResultWithOneAndThreeThreads) {
  const Scene scene = render(bumps(80), {80, 80}, nullptr, light_right, 0.005);
  const Context three{.threads = 3};
  const HeightMap a = solve(scene), b = solve(scene, {}, nullptr, three);
  EXPECT_EQ(a.iterations, b.iterations);
  for (std::size_t i = 0; i < a.height.count(); ++i) {
    if (!std::isfinite(a.height[i])) continue;
    EXPECT_NEAR(a.height[i], b.height[i], 1e-4);
  }
}

/// More than half a million pixels, cut by the object's border.
const Pinhole large_camera{{1100, 480}, 3000, 3000, 540, 230};

Scene large_scene() {
  const Surface wavy = [](int u, int v, double& height, Eigen::Vector3d& normal) {
    if (std::hypot(u - 550, 2 * (v - 240)) > 545) return false;
    const auto z = [](double x, double y) {
      return 600 + 1.6 * std::sin(0.05 * x) * std::cos(0.06 * y) + 8 * std::sin(0.008 * (x + 0.5 * y));
    };
    const auto point = [&](double x, double y) { return Eigen::Vector3d(z(x, y) * large_camera.ray(x, y)); };
    normal = (point(u, v + 1e-3) - point(u, v - 1e-3)).cross(point(u + 1e-3, v) - point(u - 1e-3, v)).normalized();
    height = -large_camera.focal() * std::log(z(u, v));
    return true;
  };
  return render(wavy, large_camera.size, &large_camera, {0.3, -0.35, -0.7, 0}, 0.001);
}

TEST(Height, LargeRastersAreSolvedByLevelsAndInTiles) {
  const Scene scene = large_scene();
  Context two{.threads = 2};
  std::vector<double> shares;
  std::ptrdiff_t tiles_reported = 0;
  two.on_progress = [&](const Progress& part) {
    shares.push_back(part.fraction);
    tiles_reported += part.message == "in tiles";
  };
  const HeightMap map = solve(scene, {}, &large_camera, two);
  EXPECT_GE(tiles_reported, 8);
  EXPECT_TRUE(std::ranges::is_sorted(shares));
  EXPECT_EQ(map.unsolved_tiles, 0);
  // The coarse level and the tiles must both reproduce the height of the surface.
  EXPECT_NEAR(height_scale(scene, map), 1, 0.01);
  EXPECT_LT(normal_error(scene, map), 2.0);
  double across = 0, inside = 0;
  for (int v = 60; v < 420; ++v) {
    const auto step = [&](int u) {
      return std::abs((map.height(u + 1, v) - map.height(u, v)) - (scene.truth(u + 1, v) - scene.truth(u, v)));
    };
    // Four tiles lie beside each other, each 275 px wide: compare steps at seams with steps in the middle of tiles.
    for (const int seam : {275, 550}) {
      for (int u = seam - 12; u < seam + 12; ++u) across += step(u);
    }
    for (const int middle : {413, 688}) {
      for (int u = middle - 12; u < middle + 12; ++u) inside += step(u);
    }
  }
  EXPECT_LT(across, 1.1 * inside) << "tiles must not show a seam";
  Context one;
  EXPECT_LT(rms_difference(map, solve(scene, {}, &large_camera, one)), 1e-3);
}

TEST(Height, LargeRastersAreSolvedByTheLinearMethodToo) {
  const Scene scene = large_scene();
  HeightOptions options;
  options.method = HeightMethod::linear;
  const Context two{.threads = 2};
  const HeightMap map = solve(scene, options, &large_camera, two);
  EXPECT_EQ(map.status, HeightStatus::converged);
  // The linear method flattens noisy parts, of a small raster as well.
  EXPECT_NEAR(height_scale(scene, map), 1, 0.05);
  EXPECT_LT(normal_error(scene, map), 3.0);
}

TEST(Height, OfASmallObjectInALargeImageKeepsItsResolution) {
  // Halved twice, the image would be small enough to be solved as a whole, but little would be left of the object.
  const Size image{1000, 850};
  const Surface in_the_middle = [&](int u, int v, double& height, Eigen::Vector3d& normal) {
    const int x = u - 468, y = v - 393;
    return x >= 0 && y >= 0 && x < 64 && y < 64 && bumps(64)(x, y, height, normal);
  };
  const Scene scene = render(in_the_middle, image, nullptr, light_above, 0.001);
  const HeightMap map = solve(scene);
  EXPECT_EQ(map.status, HeightStatus::converged);
  EXPECT_LT(normal_error(scene, map), 0.5) << "alone 0.2, halved once 0.3, halved twice 1.0";
}

TEST(Height, ConvertsDepthToHeight) {
  const Pinhole camera{{3, 1}, 400, 400, 1, 0};
  Image<float> depth(camera.size);
  depth(0, 0) = 500;
  depth(1, 0) = 510;
  depth(2, 0) = none;
  const Image<float> log_height = height_from_depth(depth, camera, true);
  EXPECT_NEAR(log_height(0, 0) - log_height(1, 0), 400 * std::log(510.0 / 500), 1e-4);
  EXPECT_NEAR(log_height(0, 0) + log_height(1, 0), 0, 1e-4);
  EXPECT_TRUE(std::isnan(log_height(2, 0)));
  const Image<float> height = height_from_depth(depth, camera, false);
  EXPECT_NEAR(height(0, 0) - height(1, 0), 10 * 400 / 505.0, 1e-4);
}

}  // namespace
}  // namespace malus
