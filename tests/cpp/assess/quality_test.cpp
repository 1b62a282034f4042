#include <gtest/gtest.h>

#include <numbers>
#include <random>
#include <set>

#include "malus/assess/polarization_depth_internal.h"
#include "malus/assess/quality_internal.h"
#include "malus/surface/mesh.h"
#include "surface/scenes.h"

namespace malus {
namespace {

using namespace scenes;

/// A fused surface and a prior that differ by known amounts: prior = plane, fused = plane + 0.2 mm checkerboard − 1 mm.
struct Case {
  FusedSurface surface = surface_of({200, 150}, 1000, [](int u, int v) { return 499 + ((u + v) % 2 ? 0.2 : -0.2); });
  DepthPrior prior;
  HeightMap height;
  PolarizationState state;
  AssessInput input;

  Case() {
    const Size size = surface.camera.size;
    surface.sigma = Image<float>(size, 1, 0.25f);
    for (int v = 0; v < 150; ++v) {
      for (int u = 0; u < 20; ++u) surface.depth(u, v) = none;
      surface.sigma(199, v) = 1.0f;
    }
    surface.status = FusionStatus::converged;
    surface.method = Fusion::refined;
    surface.warnings = {"a warning"};
    prior.depth = Image<float>(size, 1, 500.0f);
    prior.sigma = Image<float>(size, 1, 0.55f);
    prior.points_used = 321;
    prior.noise = 0.1;
    height.height = Image<float>(size, 1, 0.0f);
    height.light = {0, -std::sin(0.5), -std::cos(0.5), 0.1};
    state.valid = Mask(size, 1, 255);
    state.rho = Image<float>(size, 1, 0.25f);
    state.residual = Image<float>(size, 1, 1.0f);
    for (int u = 0; u < 200; ++u) {
      state.valid(u, 0) = 0;
      state.valid(u, 1) = 64;
    }
    state.angles_rad = {0, std::numbers::pi / 3};
    input.surface = &surface;
    input.prior = &prior;
    input.height = &height;
    input.polarization = &state;
    input.patches = {{"flat", {50, 50, 99, 89}}};
    input.profiles = {{"1", {30, 70}, {180, 70}}};
    input.registration_rms_px = {0, 0.02};
  }
};

TEST(Quality, FiguresOfAKnownCase) {
  const Case c;
  const Quality q = assess(c.input, {}, {});
  EXPECT_EQ(q.status, FusionStatus::converged);
  EXPECT_EQ(q.warnings.size(), 1u);
  EXPECT_NEAR(q.gsd, 0.499, 3e-4);
  EXPECT_EQ(q.coverage.object_pixels, 200 * 149);
  EXPECT_NEAR(q.coverage.fraction, 0.9, 1e-12);
  EXPECT_NEAR(q.coverage.prior_fraction, 1, 1e-12);
  EXPECT_NEAR(q.sigma->median_gsd, 0.25 / q.gsd, 1e-6);
  EXPECT_NEAR(q.sigma->above_limit_fraction, 1 / 200.0, 1e-12);
  EXPECT_NEAR(q.prior_vs_fused->difference_bias_gsd, -1 / q.gsd, 0.5);
  EXPECT_NEAR(q.prior_vs_fused->difference_rms_gsd, 0.2 / q.gsd, 1e-3);
  EXPECT_NEAR(q.prior_vs_fused->difference_detail_rms_gsd, 0.2 / q.gsd, 2e-3);
  EXPECT_LT(q.prior_vs_fused->prior_detail_rms_gsd, 1e-4);
  EXPECT_NEAR(q.prior_vs_fused->within_2_prior_sigma_fraction, 0.5, 0.01) << "0.8 mm is within 1.1 mm, 1.2 mm is not";
  EXPECT_EQ(q.prior->points_used, 321);
  EXPECT_NEAR(q.polarization->valid_fraction, 148 / 149.0, 1e-12);
  EXPECT_NEAR(q.polarization->saturated_fraction, 1 / 149.0, 1e-12);
  EXPECT_NEAR(q.polarization->angles_deg[1], 60, 1e-12);
  EXPECT_NEAR(q.polarization_height->light_to_view_deg, 0.5 * 180 / std::numbers::pi, 1e-9);
  ASSERT_EQ(q.patches.size(), 1u);
  EXPECT_NEAR(q.patches[0].fused->rmse_gsd, 0.2 / q.gsd, 1e-3);
  EXPECT_LT(q.patches[0].prior->rmse_gsd, 1e-6);
  EXPECT_LT(q.patches[0].polarization->rmse_gsd, 1e-6);
  EXPECT_EQ(q.profiles[0].status, ProfileStatus::done);
  EXPECT_FALSE(q.reference);
}

TEST(Quality, TheTiltOfAnObjectIsNoDetail) {
  Case c;
  const auto tilt = [](int u, int v) { return static_cast<float>(0.3 * u - 0.2 * v); };
  for (int v = 0; v < 150; ++v) {
    for (int u = 0; u < 200; ++u) c.surface.depth(u, v) += tilt(u, v), c.prior.depth(u, v) += tilt(u, v);
  }
  const Quality q = assess(c.input, {}, {});
  EXPECT_LT(q.prior_vs_fused->prior_detail_rms_gsd, 1e-3);
  EXPECT_LT(q.prior_vs_fused->prior_detail_mad_gsd, 1e-3);
  EXPECT_NEAR(q.prior_vs_fused->fused_detail_rms_gsd, 0.2 / q.gsd, 2e-3);
}

TEST(Quality, APatchAndAProfileBesideTheSurfaceAreToldOf) {
  Case c;
  std::vector<std::string> said;
  Context context;
  context.on_log = [&](LogLevel, const std::string& message) { said.push_back(message); };
  assess(c.input, {}, context);
  EXPECT_TRUE(said.empty());
  c.input.patches.push_back({"beside", {2, 50, 15, 89}});
  c.input.profiles.push_back({"2", {2, 70}, {15, 70}});
  EXPECT_FALSE(assess(c.input, {}, context).patches.back().fused);
  ASSERT_EQ(said.size(), 2u);
  EXPECT_NE(said[0].find("[[patch]] \"beside\": ten pixels"), std::string::npos) << said[0];
  EXPECT_NE(said[1].find("[[profile]] \"2\": its line"), std::string::npos) << said[1];
}

TEST(Quality, FiguresCanOnlyLowerTheSurfacesConfidence) {
  Case c;
  c.prior.sigma.fill(2.0f);
  EXPECT_EQ(assess(c.input, {}, {}).confidence.level, ConfidenceLevel::high);
  c.surface.confidence.limit(ConfidenceLevel::partial, "half of it");
  EXPECT_EQ(assess(c.input, {}, {}).confidence.level, ConfidenceLevel::partial);
  c.surface.sigma.fill(20.0f);
  const Quality unsure = assess(c.input, {}, {});
  EXPECT_EQ(unsure.confidence.level, ConfidenceLevel::low);
  EXPECT_EQ(unsure.confidence.reasons.size(), 2u);
  c.surface.sigma.fill(0.25f);
  c.prior.sigma.fill(0.1f);
  EXPECT_EQ(assess(c.input, {}, {}).confidence.level, ConfidenceLevel::low) << "the surface is too far from its prior";
}

TEST(Quality, AMostlyFilledPriorLowersTheConfidence) {
  Case c;
  c.prior.sigma.fill(2.0f);
  for (const auto& [filled, level] : {std::pair{0.2, ConfidenceLevel::high},
                                      {0.3, ConfidenceLevel::partial},
                                      {0.8, ConfidenceLevel::low},
                                      {static_cast<double>(none), ConfidenceLevel::partial}}) {
    c.prior.filled_fraction = filled;
    EXPECT_EQ(assess(c.input, {}, {}).confidence.level, level) << filled;
  }
}

TEST(Quality, APriorThatIsMostlyAVisualHullIsTrustedInPart) {
  Case c;
  c.prior.sigma.fill(2.0f);
  c.prior.hull_fraction = 0.2;
  EXPECT_EQ(assess(c.input, {}, {}).confidence.level, ConfidenceLevel::high);
  c.prior.hull_fraction = 0.9;
  const Confidence confidence = assess(c.input, {}, {}).confidence;
  EXPECT_EQ(confidence.level, ConfidenceLevel::partial);
  ASSERT_EQ(confidence.reasons.size(), 1u);
  EXPECT_NE(confidence.reasons[0].find("On 90 % of the object the prior is the photos' visual hull"), std::string::npos)
      << confidence.reasons[0];
}

TEST(Quality, APriorOfUnknownPrecisionIsTrustedInPart) {
  Case c;
  c.prior.sigma.fill(2.0f);
  c.prior.assumes_sigma = true;
  const Confidence confidence = assess(c.input, {}, {}).confidence;
  EXPECT_EQ(confidence.level, ConfidenceLevel::partial);
  ASSERT_EQ(confidence.reasons.size(), 1u);
  EXPECT_NE(confidence.reasons[0].find("Give it as sigma in [prior]"), std::string::npos) << confidence.reasons[0];
}

TEST(Quality, PixelsWithoutPolarizationAreNotTrusted) {
  Case c;
  c.prior.sigma.fill(2.0f);
  for (int v = 2; v < 22; ++v) {
    for (int u = 0; u < 200; ++u) c.state.valid(u, v) = 64;
  }
  const Confidence confidence = assess(c.input, {}, {}).confidence;
  EXPECT_EQ(confidence.level, ConfidenceLevel::partial);
  ASSERT_EQ(confidence.reasons.size(), 1u);
  EXPECT_NE(confidence.reasons[0].find("On 14 % of the object the polarization is not usable"), std::string::npos)
      << confidence.reasons[0];
}

TEST(Quality, MissingFiguresLowerTheConfidence) {
  Case c;
  c.surface.sigma.fill(none);
  c.prior.sigma.fill(2.0f);
  EXPECT_EQ(assess(c.input, {}, {}).confidence.level, ConfidenceLevel::partial) << "sigma is not known";
  c.surface.sigma.fill(0.25f);
  c.prior.sigma.fill(none);
  EXPECT_EQ(assess(c.input, {}, {}).confidence.level, ConfidenceLevel::partial) << "the prior's sigma is not known";
  c.input.prior = nullptr;
  EXPECT_EQ(assess(c.input, {}, {}).confidence.level, ConfidenceLevel::partial) << "there is no prior";
}

TEST(Quality, OnlyASurfaceIsNeeded) {
  const Case c;
  AssessInput input;
  input.surface = &c.surface;
  const Quality q = assess(input, {}, {});
  EXPECT_FALSE(q.prior || q.prior_vs_fused || q.polarization || q.polarization_height || q.reference);
  EXPECT_EQ(q.coverage.fraction, 1);
  EXPECT_THROW(assess({}, {}, {}), Error);
}

TEST(Quality, ComparesWithAReferenceOnRequest) {
  const Case c;
  FusedSurface truth = c.surface;
  truth.depth.fill(500.0f);
  const TriangleMesh reference = mesh_from_depth(truth, {}, {}, {});
  AssessInput input = c.input;
  input.reference = &reference;
  const Quality q = assess(input, {}, {});
  EXPECT_NEAR(q.reference->distance_gsd.mean, 1 / q.gsd, 0.01);
}

TEST(Quality, GsdFallsBackToTheMedianWhereTheCenterIsEmpty) {
  const Pinhole camera = centered_camera({100, 80}, 1000);
  Image<float> depth(camera.size, 1, none);
  EXPECT_THROW(ground_sampling_distance(depth, camera), Error);
  for (int u = 0; u < 11; ++u) depth(u, 3) = static_cast<float>(700 + u);
  EXPECT_NEAR(ground_sampling_distance(depth, camera), 0.705, 1e-9);
  depth(50, 40) = 300;
  EXPECT_NEAR(ground_sampling_distance(depth, camera), 0.3, 1e-9);
}

TEST(Quality, RefusesRastersOfAnotherSize) {
  Case c;
  c.prior.depth = Image<float>({10, 10});
  EXPECT_THROW(assess(c.input, {}, {}), Error);
  AssessOptions options;
  options.histogram_bins = -1;
  EXPECT_THROW(assess(Case().input, options, {}), Error);
}

TEST(Quality, FieldNamesAreUnique) {
  std::multiset<std::string_view> names;
  const Quality quality;
  Quality::fields(quality, [&](std::string_view name, const auto&) { names.insert(name); });
  EXPECT_EQ(names.size(), 18u);
  for (const std::string_view name : names) EXPECT_EQ(names.count(name), 1u) << name;
}

TEST(Quality, SameWithAnyNumberOfThreads) {
  const Case c;
  const Context three{.threads = 3};
  const Quality a = assess(c.input, {}, {}), b = assess(c.input, {}, three);
  EXPECT_EQ(a.prior_vs_fused->difference_detail_rms_gsd, b.prior_vs_fused->difference_detail_rms_gsd);
  EXPECT_EQ(a.profiles[0].roughness_fused_gsd, b.profiles[0].roughness_fused_gsd);
  EXPECT_EQ(a.patches[0].polarization->rmse, b.patches[0].polarization->rmse);
}

TEST(PolarizationDepth, HeightsOfBothProjectionsConvertBackToTheirDepth) {
  const Pinhole camera = centered_camera({60, 50}, 800);
  Image<float> depth(camera.size);
  for (int v = 0; v < 50; ++v) {
    for (int u = 0; u < 60; ++u) depth(u, v) = static_cast<float>(400 + 5 * std::sin(0.2 * u) + 0.1 * v);
  }
  for (const bool perspective : {true, false}) {
    HeightMap height;
    height.perspective = perspective;
    height.height = Image<float>(camera.size);
    for (std::size_t i = 0; i < depth.count(); ++i) {
      height.height[i] = static_cast<float>(perspective ? -800 * std::log(depth[i] / 410) : 800 * (1 - depth[i] / 410));
    }
    height.height(3, 3) = none;
    const Image<float> back = depth_from_height(height, depth, camera, {});
    EXPECT_TRUE(std::isnan(back(3, 3)));
    for (std::size_t i = 0; i < depth.count(); ++i) {
      if (std::isfinite(height.height[i])) {
        ASSERT_NEAR(back[i], depth[i], 2e-3);
      }
    }
    EXPECT_TRUE(depth_from_height(height, Image<float>(camera.size, 1, none), camera, {}).empty());
  }
}

}  // namespace
}  // namespace malus
