#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <numbers>

#include "malus/core/error.h"
#include "malus/fusion/grid_fusion_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

constexpr float none = std::numeric_limits<float>::quiet_NaN();
constexpr double focal = 1000, distance_mm = 500, gsd_mm = distance_mm / focal;

using Height = std::function<double(int, int)>;

/// Prior whose perspective height is `height` (GSD, positive towards the camera), up to a constant.
DepthPrior prior_of(Size size, const Height& height, double sigma_gsd = 1) {
  DepthPrior prior;
  prior.camera = {size, focal, focal, size.width / 2.0, size.height / 2.0};
  prior.pose.translation = {1, 2, 3};
  prior.depth = Image<float>(size);
  prior.sigma = Image<float>(size, 1, static_cast<float>(sigma_gsd * gsd_mm));
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      prior.depth(u, v) = static_cast<float>(distance_mm * std::exp(-height(u, v) / focal));
    }
  }
  return prior;
}

HeightMap map_of(Size size, const Height& height, bool perspective = true) {
  HeightMap map;
  map.height = Image<float>(size);
  map.perspective = perspective;
  map.status = HeightStatus::converged;
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) map.height(u, v) = static_cast<float>(height(u, v));
  }
  return map;
}

double height_of(const FusedSurface& surface, int u, int v) {
  return -focal * std::log(surface.depth(u, v) / distance_mm);
}

TEST(GridFusion, TakesLowFrequenciesFromThePriorAndDetailFromPolarization) {
  const Size size{320, 240};
  const double tau = 2 * std::numbers::pi;
  const auto low = [=](int u, int v) { return 6 * std::sin(tau * u / 320) + 0.05 * v; };
  // The detail alternates in sign between nodes 4 px apart; a Gaussian of one node reduces it to exp(−π² / 2).
  const auto detail = [=](int u, int v) { return 0.8 * std::cos(tau * (u - 2) / 8) * std::cos(tau * (v - 2) / 8); };
  const auto drift = [](int u, int v) { return 40 - 0.2 * u + 1e-3 * v * v; };
  const DepthPrior prior = prior_of(size, low);
  const FusedSurface fused =
      fuse_grid(map_of(size, [&](int u, int v) { return detail(u, v) + drift(u, v); }), prior, {}, {});
  EXPECT_EQ(fused.method, Fusion::grid);
  EXPECT_TRUE(fused.warnings.empty());
  EXPECT_EQ(fused.pose.translation, prior.pose.translation);
  double largest = 0;
  for (int v = 20; v < 220; ++v) {
    for (int u = 20; u < 300; ++u) {
      largest = std::max(largest, std::abs(height_of(fused, u, v) - low(u, v) - detail(u, v)));
    }
  }
  EXPECT_LT(largest, 0.06);
}

TEST(GridFusion, LiteralFormFollowsThePublishedSteps) {
  // Scale both to 0–1, take differences at the nodes (pixels 2 and 6) without smoothing, interpolate them bilinearly,
  // add them, and scale back.
  const Size size{9, 9};
  const auto prior_depth = [](int u, int v) { return 500 + 2.0 * u + 0.5 * v * v; };
  const auto polarization = [](int u, int v) { return 3.0 * ((u * 5 + v * 3) % 7) - 4; };
  DepthPrior prior = prior_of(size, [](int, int) { return 0; });
  for (int v = 0; v < 9; ++v) {
    for (int u = 0; u < 9; ++u) prior.depth(u, v) = static_cast<float>(prior_depth(u, v));
  }
  GridFusionOptions options;
  options.sigma_nodes = 0;
  options.unit_scaling = true;
  const FusedSurface fused = fuse_grid(map_of(size, polarization, false), prior, options, {});

  const double nearest = 500, farthest = 500 + 16 + 32;
  const auto prior_unit = [&](int u, int v) { return (farthest - prior_depth(u, v)) / (farthest - nearest); };
  const auto polarization_unit = [&](int u, int v) { return (polarization(u, v) + 4) / 18; };
  const auto node = [&](int u, int v) { return prior_unit(u, v) - polarization_unit(u, v); };
  for (int v = 0; v < 9; ++v) {
    for (int u = 0; u < 9; ++u) {
      const double s = std::clamp((u - 2) / 4.0, 0.0, 1.0), t = std::clamp((v - 2) / 4.0, 0.0, 1.0);
      const double transferred =
          (1 - t) * ((1 - s) * node(2, 2) + s * node(6, 2)) + t * ((1 - s) * node(2, 6) + s * node(6, 6));
      const double expected = farthest - (polarization_unit(u, v) + transferred) * (farthest - nearest);
      EXPECT_NEAR(fused.depth(u, v), expected, 1e-3) << u << ' ' << v;
    }
  }
}

TEST(GridFusion, OrthographicHeightsMoveDepthByTheMeanGsd) {
  const Size size{40, 40};
  const DepthPrior prior = prior_of(size, [](int, int) { return 0; });
  const auto checker = [](int u, int v) { return (u / 4 + v / 4) % 2 == 0 ? 1.0 : -1.0; };
  const FusedSurface fused = fuse_grid(map_of(size, checker, false), prior, {}, {});
  EXPECT_NEAR(fused.depth(18, 18), distance_mm - gsd_mm * checker(18, 18), 0.02 * gsd_mm);
  EXPECT_NEAR(fused.depth(22, 18), distance_mm - gsd_mm * checker(22, 18), 0.02 * gsd_mm);
}

TEST(GridFusion, GapsInTheHeightKeepThePriorAndGapsInThePriorStayEmpty) {
  const Size size{64, 48};
  DepthPrior prior = prior_of(size, [](int u, int v) { return 0.1 * u - 0.2 * v; });
  HeightMap height = map_of(size, [](int u, int v) { return 0.1 * u - 0.2 * v + 7; });
  for (int v = 0; v < 48; ++v) {
    for (int u = 0; u < 64; ++u) {
      if (u < 10) prior.depth(u, v) = prior.sigma(u, v) = none;
      if (v > 30) height.height(u, v) = none;
    }
  }
  height.status = HeightStatus::iteration_limit;
  height.last_update = std::tan(0.7 * std::numbers::pi / 180);
  height.iterations = 12;
  const FusedSurface fused = fuse_grid(height, prior, {}, {});
  for (int v = 0; v < 48; ++v) {
    for (int u = 0; u < 64; ++u) {
      ASSERT_EQ(std::isnan(fused.depth(u, v)), u < 10);
      ASSERT_EQ(std::isnan(fused.sigma(u, v)), u < 10);
      if (u >= 10) {
        ASSERT_NEAR(fused.depth(u, v), prior.depth(u, v), v > 30 ? 1e-4 : 1e-3 * gsd_mm + 1e-3) << u << ' ' << v;
      }
    }
  }
  EXPECT_FALSE(std::isnan(fused.normals(30, 20, 2)));
  EXPECT_TRUE(std::isnan(fused.normals(3, 20, 2)));
  ASSERT_EQ(fused.warnings.size(), 1U);
  EXPECT_NE(fused.warnings[0].find("its slopes by 0.7° in the last of 12 rounds"), std::string::npos);
  EXPECT_NE(fused.warnings[0].find("less sure by about that"), std::string::npos);
  height.over_prior = 14.2;
  const std::string too_high = fuse_grid(height, prior, {}, {}).warnings.at(0);
  EXPECT_NE(too_high.find("14 times as high as the prior"), std::string::npos) << too_high;
}

TEST(GridFusion, PartsThatNothingConnectsKeepTheirPlacesInThePrior) {
  // Two fragments, and between them a chip so small that no node (pixels 2 + 4 i) lies on it.
  const Size size{96, 48};
  const auto part_of = [](int u, int v) {
    if (u < 40) return 0;
    if (u >= 56) return 1;
    return (u == 47 || u == 48) && (v == 20 || v == 21) ? 2 : -1;
  };
  constexpr double in_prior[] = {0, 50, -30}, constants[] = {0, 3, 5};
  const auto on_parts = [&](const double* heights) {
    return [=](int u, int v) { return part_of(u, v) < 0 ? static_cast<double>(none) : heights[part_of(u, v)]; };
  };
  const DepthPrior prior = prior_of(size, on_parts(in_prior));
  const FusedSurface fused = fuse_grid(map_of(size, on_parts(constants)), prior, {}, {});
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      const int part = part_of(u, v);
      ASSERT_EQ(std::isfinite(fused.depth(u, v)), part >= 0);
      if (part < 0) continue;
      ASSERT_NEAR(height_of(fused, u, v), in_prior[part], 0.01) << u << ' ' << v;
      ASSERT_NEAR(fused.sigma(u, v), prior.sigma(u, v), 1e-4) << u << ' ' << v;
    }
  }
}

TEST(GridFusion, GaussianWiderThanTheGridLeavesOnlyTheMeanDifference) {
  const Size size{40, 40};
  const DepthPrior prior = prior_of(size, [](int, int) { return 12; });
  const auto checker = [](int u, int v) { return (u / 4 + v / 4) % 2 == 0 ? 1.0 : -1.0; };
  GridFusionOptions options;
  options.sigma_nodes = 100;
  const FusedSurface fused = fuse_grid(map_of(size, checker), prior, options, {});
  EXPECT_NEAR(height_of(fused, 18, 18), 12 + checker(18, 18), 0.02);
  EXPECT_NEAR(height_of(fused, 22, 18), 12 + checker(22, 18), 0.02);
}

TEST(GridFusion, SigmaAddsTheDisagreementInDetail) {
  const Size size{80, 80};
  const DepthPrior prior = prior_of(
      size, [](int, int) { return 0; }, 0.5);
  const FusedSurface same = fuse_grid(map_of(size, [](int, int) { return 0; }), prior, {}, {});
  EXPECT_NEAR(same.sigma(40, 40) / gsd_mm, 0.5, 1e-3);
  // At the nodes (pixels 2 + 4 i) the polarization height alternates between 2 and −2 GSD.
  const auto checker = [](int u, int v) { return (u / 4 + v / 4) % 2 == 0 ? 2.0 : -2.0; };
  const FusedSurface rough = fuse_grid(map_of(size, checker), prior, {}, {});
  EXPECT_NEAR(rough.sigma(40, 40) / gsd_mm, std::hypot(0.5, 2.0), 0.05);
}

TEST(GridFusion, IsTheSameWithMoreThreads) {
  const Size size{123, 77};
  const DepthPrior prior = prior_of(size, [](int u, int v) { return std::sin(0.1 * u) + 0.1 * v; });
  const HeightMap height = map_of(size, [](int u, int v) { return std::cos(0.7 * u * v); });
  const Context four{.threads = 4};
  const FusedSurface a = fuse_grid(height, prior, {}, {}), b = fuse_grid(height, prior, {}, four);
  EXPECT_EQ(a.depth, b.depth);
  EXPECT_EQ(a.sigma, b.sigma);
}

TEST(GridFusion, RejectsMismatchedInputsAndInvalidOptions) {
  const Size size{32, 32};
  const DepthPrior prior = prior_of(size, [](int, int) { return 0; });
  const HeightMap height = map_of(size, [](int, int) { return 0; });
  expect_error(ErrorCode::input, [&] { fuse_grid(map_of({32, 31}, [](int, int) { return 0; }), prior, {}, {}); });
  HeightMap nothing = map_of(size, [](int, int) { return none; });
  nothing.status = HeightStatus::light_along_view;
  expect_error(
      ErrorCode::data, [&] { fuse_grid(nothing, prior, {}, {}); }, "light along the view direction");
  HeightMap elsewhere = height;
  DepthPrior left = prior;
  for (int v = 0; v < 32; ++v) {
    for (int u = 0; u < 32; ++u) (u < 16 ? elsewhere.height : left.depth)(u, v) = none;
  }
  expect_error(
      ErrorCode::data, [&] { fuse_grid(elsewhere, left, {}, {}); }, "share no node");
  GridFusionOptions wide;
  wide.grid_px = 32;  // its node lies at pixel 16, 16
  expect_error(
      ErrorCode::input,
      [&] { fuse_grid(map_of(size, [](int u, int v) { return u < 9 && v < 9 ? 1.0 : none; }), prior, wide, {}); },
      "grid.grid_px = 32");
  DepthPrior unsure = prior;
  unsure.sigma = {};
  expect_error(ErrorCode::input, [&] { fuse_grid(height, unsure, {}, {}); });
  GridFusionOptions options;
  options.grid_px = 0;
  expect_error(ErrorCode::input, [&] { fuse_grid(height, prior, options, {}); });
  options = {};
  options.sigma_nodes = -1;
  expect_error(ErrorCode::input, [&] { fuse_grid(height, prior, options, {}); });
}

}  // namespace
}  // namespace malus
