#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <functional>
#include <memory>
#include <random>
#include <string>

#include "malus/fusion/gain_by_scale_internal.h"
#include "malus/fusion/refine_internal.h"
#include "malus/fusion/refinement_weights_internal.h"
#include "quick_refinement.h"
#include "synthetic_station.h"

namespace malus {
namespace {

SyntheticOptions matte_scene() {
  SyntheticOptions scene;
  scene.size = {192, 160};
  scene.model.environment.radiance.fill(0.1);
  return scene;
}

/// Gains of a surface that is `overshoot` times `movement` away from the prior. The measurement is the prediction at
/// `movement` plus noise of standard deviation `noise`. s0 is set only for a metal. `change` may change the field last.
GainByScale::Gains gains_of(
    const std::function<double(int, int)>& movement, double noise, double overshoot = 1,
    const ReflectionModel& model = matte_scene().model, double texture = 0,
    const std::function<void(RefinementField&)>& change = [](RefinementField&) {}, double noise_share = 1) {
  const SyntheticStation station = make_station(matte_scene());
  RefinementImage image = make_image(station.state, station.prior, Context{});
  image.kind.fill(Reflection::diffuse);
  image.reflection = model;
  RefinementField field = image.part(image.everything(), Context{});
  field.stokes_precision.fill(1e4);
  std::mt19937 random(3);
  std::normal_distribution<double> gauss(0, noise);
  const auto move = [&](double factor) {
    for (int v = 0; v < field.size().height; ++v) {
      for (int u = 0; u < field.size().width; ++u) field.x(u, v) = field.x_prior(u, v) + factor * movement(u, v);
    }
  };
  move(1);
  for (int v = 0; v < field.size().height; ++v) {
    for (int u = 0; u < field.size().width; ++u) {
      if (!field.usable(u, v)) continue;
      const Slopes slopes = central_slopes(field, u, v);
      const PredictedStokes light = field.reflection_at(u, v).predict(slopes.p, slopes.q);
      field.s1(u, v) = static_cast<float>(light.s1 + gauss(random));
      field.s2(u, v) = static_cast<float>(light.s2 + gauss(random));
      if (model.metal_error > 0) field.s0(u, v) = static_cast<float>(light.mirrored * (1 + texture * gauss(random)));
    }
  }
  move(overshoot);
  change(field);
  GainByScale gain(image.size(), model.metal_error > 0, noise_share);
  gain.add(field, {0, 50}, 0, Context{});  // two parts that share a row of cells
  gain.add(field, {50, 161}, 0, Context{});
  return gain.gains(Context{});
}

double at_center(const GainByScale::Gains::Scale& scale) {
  return between_cells(scale.gain, scale.cell_px, 96, 80);
}

/// Detail of a few pixels on waves of about fifty pixels.
double relief(int u, int v) {
  return 0.05 * std::sin(1.5 * u) * std::cos(1.4 * v) + 2 * std::sin(0.11 * u) * std::cos(0.09 * v);
}

TEST(GainByScale, WithoutNoiseTheWholeMovementIsGain) {
  const GainByScale::Gains gains = gains_of(relief, 0);
  ASSERT_EQ(gains.scales.size(), 6U);  // single pixels, means of 4, 8, 16 and 32 px, and means of 64 px
  for (const GainByScale::Gains::Scale& scale : gains.scales) EXPECT_GT(at_center(scale), 0.99);
  EXPECT_GT(at_center(gains.all), 0.99);
}

TEST(GainByScale, PixelNoiseRemovesTheGainOfDetailButNotOfWaves) {
  const GainByScale::Gains gains = gains_of(relief, 0.02);
  EXPECT_LT(at_center(gains.scales.front()), 0.2) << "the detail is weaker than the noise";
  EXPECT_GT(at_center(gains.scales[4]), 0.9) << "means of 32 px minus means of 64 px";
  EXPECT_LT(at_center(gains.all), at_center(gains.scales[4]));
}

TEST(GainByScale, NoiseThatTheSurfaceFollowsExactlyIsNoGain) {
  const auto gain_of_detail = [](float noise, double noise_share = 1) {
    const auto change = [noise](RefinementField& field) { field.variance.fill(noise * noise); };
    return at_center(gains_of(relief, 0, 1, matte_scene().model, 0, change, noise_share).scales.front());
  };
  EXPECT_GT(gain_of_detail(1e-4F), 0.99);
  EXPECT_LT(gain_of_detail(0.02F), 0.2) << "the camera's noise is stronger than the detail, whatever residual is left";
  EXPECT_GT(gain_of_detail(0.02F, 0), 0.99) << "the images have less noise than is assumed";
}

TEST(GainByScale, TheImagesResidualsTellTheirNoise) {
  const auto noise_share = [](float residual) {
    SyntheticStation station = make_station(matte_scene());
    station.state.residual = Image<float>(station.state.size(), 1, residual);
    return make_image(station.state, station.prior, Context{}).noise_share;
  };
  EXPECT_EQ(noise_share(0), 0) << "three images have no residuals";
  EXPECT_NEAR(noise_share(0.5F), 0.25, 1e-6);
  EXPECT_EQ(noise_share(2), 1) << "misaligned images are not noise";
}

TEST(GainByScale, AHighlightDoesNotHideTheNoiseAroundIt) {
  const auto highlight = [](RefinementField& field) {
    const PixelRect bright{92, 76, 100, 84};
    for_each_pixel(bright, [&](int u, int v) {
      field.s0(u, v) *= 100;
      field.x(u, v) += relief(u, v);
    });
    for_each_pixel(bright, [&](int u, int v) {
      const Slopes slopes = central_slopes(field, u, v);
      const PredictedStokes light = field.reflection_at(u, v).predict(slopes.p, slopes.q);
      field.s1(u, v) = static_cast<float>(light.s1);
      field.s2(u, v) = static_cast<float>(light.s2);
    });
  };
  const auto beside = [&](const std::function<void(RefinementField&)>& change) {
    const GainByScale::Gains gains = gains_of(relief, 0.02, 1, matte_scene().model, 0, change);
    return between_cells(gains.scales.front().gain, gains.scales.front().cell_px, 110, 80);
  };
  EXPECT_NEAR(beside(highlight), beside([](RefinementField&) {}), 0.1);
}

TEST(GainByScale, AnOvershootIsScaledBack) {
  const GainByScale::Gains gains = gains_of(relief, 0, 1.5);
  EXPECT_NEAR(at_center(gains.scales[4]), 1 / 1.5, 0.05);
  EXPECT_LT(at_center(gains_of(relief, 0, -0.5).scales[4]), 0.01) << "movement in the wrong direction";
}

TEST(GainByScale, TextureInAMetalsBrightnessIsNoGain) {
  Surroundings window;
  window.finishes.usual = 0.3;
  window.radiance = Image<float>({Surroundings::cells, Surroundings::cells});
  for (const Surroundings::Cell& cell : Surroundings::all_cells())
    window.radiance(cell.column, cell.row) = cell.hx > 0 ? 1.0F : 0.1F;
  ReflectionModel metal;
  const Pinhole view = make_station(matte_scene()).prior.camera;
  metal.mirrored = std::make_shared<MirroredLightTable>(window, std::complex(0.63, 3.19), view, Context{});
  metal.metal_error = 0.05;
  EXPECT_GT(at_center(gains_of(relief, 0, 1, metal).scales.front()), 0.99);
  const double noise = 1e-4, texture = 0.1 / noise;
  EXPECT_LT(at_center(gains_of(relief, noise, 1, metal, texture).scales.front()), 0.2);
  EXPECT_GT(at_center(gains_of(relief, noise, 1, metal).scales.front()), 0.9) << "s0 without texture";
}

/// Gains of 1 at every scale except the finest.
GainByScale::Gains but_for_the_finest(Size image, float finest) {
  GainByScale::Gains gains;
  for (const int cell_px : {4, 8, 16, 32, 64, 64}) {
    const auto cells = [&](int length) { return (length + cell_px - 1) / cell_px; };
    Image<float> gain({cells(image.width), cells(image.height)});
    gain.fill(gains.scales.empty() ? finest : 1.0F);
    gains.scales.push_back({cell_px, gain});
  }
  return gains;
}

TEST(GainByScale, ScalesAddUpToTheWholeMovement) {
  const SyntheticStation station = make_station(matte_scene());
  RefinementImage image = make_image(station.state, station.prior, Context{});
  const Image<double> prior = image.x;
  for (int v = 0; v < image.size().height; ++v) {
    for (int u = 0; u < image.size().width; ++u) image.x(u, v) += relief(u, v);
  }
  const Image<float> all = movement_that_is_gain(image, prior, but_for_the_finest(image.size(), 1), Context{});
  const Image<float> smooth = movement_that_is_gain(image, prior, but_for_the_finest(image.size(), 0), Context{});
  double largest = 0, of_waves = 0;
  for (int v = 20; v < 140; ++v) {
    for (int u = 20; u < 170; ++u) {
      largest = std::max(largest, std::abs(all(u, v) - relief(u, v)));
      const double waves = 2 * std::sin(0.11 * u) * std::cos(0.09 * v);
      of_waves = std::max(of_waves, std::abs(smooth(u, v) - waves));
    }
  }
  EXPECT_LT(largest, 1e-4);
  EXPECT_LT(of_waves, 0.05) << "the detail is removed and the waves are kept";
}

TEST(GainByScale, NoiseIsNotTakenForDetailWhereThePriorLacksNone) {
  SyntheticOptions scene = matte_scene();
  scene.bump_gsd = 0.1;
  scene.noise = 0.03;
  const SyntheticStation station = make_station(scene);
  const RefineInput diffuse{1.5, ReflectionChoice::diffuse, {}};
  RefineOptions options = quick();
  const RefineResult held = refine(station.state, station.prior, diffuse, options, Context{});
  options.evidence = false;
  const RefineResult free = refine(station.state, station.prior, diffuse, options, Context{});
  const auto error = [&](const Image<float>& depth) {
    return rms_error_gsd(depth, station.truth, station.prior.camera);
  };
  const double prior = error(station.prior.depth);
  EXPECT_GT(error(free.surface.depth), 1.3 * prior) << "without evidence, noise must worsen the surface";
  EXPECT_LT(error(held.surface.depth) - prior, 0.5 * (error(free.surface.depth) - prior));
  EXPECT_LT(held.report.gain_share, 0.7);
  EXPECT_TRUE(std::isnan(free.report.gain_share));
  EXPECT_NE(held.surface.confidence.level, ConfidenceLevel::high);
  ASSERT_FALSE(held.surface.confidence.reasons.empty());
  EXPECT_NE(held.surface.confidence.reasons.front().find("cannot be told from noise"), std::string::npos)
      << held.surface.confidence.reasons.front();
}

}  // namespace
}  // namespace malus
