#include <gtest/gtest.h>

#include <cmath>

#include "malus/fusion/coarse_level_internal.h"
#include "malus/fusion/refine_internal.h"
#include "synthetic_station.h"

namespace malus {
namespace {

SyntheticStation station_of(Size size) {
  SyntheticOptions options;
  options.size = size;
  return make_station(options);
}

TEST(CoarseLevel, ShowsTheSameSurfaceAtALargerGsd) {
  SyntheticStation station = station_of({61, 48});
  station.state.valid(20, 10) = static_cast<std::uint8_t>(PixelState::saturated);
  station.state.valid(30, 30) = static_cast<std::uint8_t>(PixelState::outside);
  const RefinementImage fine = make_image(station.state, station.prior, Context{});
  const RefinementImage coarse = coarsened(fine, Context{});
  ASSERT_EQ(coarse.size(), (Size{32, 25}));  // nodes
  // The center of four fine pixels lies on the ray of their coarse pixel, at the same depth and with the same slope.
  EXPECT_LT((coarse.camera.ray(7, 9) - fine.camera.ray(14.5, 18.5)).norm(), 1e-12);
  // Every other node of the fine image is a node of the coarse image.
  EXPECT_NEAR(coarse.depth_of(coarse.x(7, 9)), fine.depth_of(fine.x(14, 18)), 1e-9);
  EXPECT_NEAR(coarse.x(8, 9) - coarse.x(7, 9), (fine.x(16, 18) - fine.x(14, 18)) / 2, 1e-9);
  const auto variance = [&](int u, int v) { return fine.source(u, v).variance; };
  EXPECT_NEAR(coarse.source(7, 9).prior_sigma, fine.source(14, 18).prior_sigma / 2, 1e-3);
  EXPECT_NEAR(coarse.source(7, 9).variance, variance(14, 18) / 4, 0.01 * variance(14, 18));
  EXPECT_NEAR(coarse.source(10, 5).variance, variance(20, 11) / 3, 0.01 * variance(20, 11));
  EXPECT_NE(coarse.object(15, 15), 0);
}

TEST(CoarseLevel, APixelHasTheFinishOfMostOfItsPixels) {
  SyntheticStation station = station_of({61, 48});
  RefinementImage fine = make_image(station.state, station.prior, Context{});
  EXPECT_TRUE(coarsened(fine, Context{}).other_finish.empty());
  fine.other_finish = Mask(fine.size());
  for (int u = 0; u < 23; ++u) {
    for (int v = 0; v < fine.size().height; ++v) fine.other_finish(u, v) = 255;
  }
  fine.other_finish(23, 10) = 255;
  const RefinementImage coarse = coarsened(fine, Context{});
  EXPECT_TRUE(coarse.has_other_finish(10, 5));
  EXPECT_TRUE(coarse.has_other_finish(11, 5)) << "three of four";
  EXPECT_FALSE(coarse.has_other_finish(11, 6)) << "two of four";
  EXPECT_FALSE(coarse.has_other_finish(12, 5));
}

TEST(CoarseLevel, ChangesAreTransferredToTheFineLevel) {
  SyntheticStation station = station_of({60, 48});
  for (int v = 0; v < 48; ++v) {
    for (int u = 0; u < 11; ++u) station.state.valid(u, v) = static_cast<std::uint8_t>(PixelState::outside);
  }
  RefinementImage fine = make_image(station.state, station.prior, Context{});
  RefinementImage coarse = coarsened(fine, Context{});
  // The change has a slope of 0.2 GSD per pixel along u and −0.1 along v.
  const auto change = [](double u, double v) { return 3 + 0.2 * u - 0.1 * v; };
  for (int row = 0; row < coarse.size().height; ++row) {
    for (int column = 0; column < coarse.size().width; ++column) {
      coarse.x(column, row) += change(2 * column, 2 * row) / 2;
    }
  }
  coarse.reflection.mirror.body = 0.3;
  const Image<double> before = fine.x;
  take_over(fine, coarse, Context{});
  EXPECT_EQ(fine.reflection.mirror.body, 0.3);
  for (int v = 2; v < 46; ++v) {
    for (int u = 14; u < 58; ++u) ASSERT_NEAR(fine.x(u, v) - before(u, v), change(u, v), 1e-9) << u << " " << v;
  }
  EXPECT_NEAR(fine.x(11, 20) - before(11, 20), change(11, 20), 1e-9);
  EXPECT_TRUE(std::isnan(fine.x(5, 20)));
}

TEST(CoarseLevel, RefinementWithCoarseLevelsReducesTheError) {
  SyntheticOptions scene;
  scene.size = {96, 80};
  scene.kind = Reflection::specular;
  scene.model.mirror = {0.12, 13};
  const SyntheticStation station = make_station(scene);
  RefineOptions options;
  options.coarsest_px = 30;
  const RefineResult result = refine(station.state, station.prior, {}, options, Context{});
  EXPECT_EQ(result.report.iterations.front().binning, 2);
  EXPECT_EQ(result.report.iterations.back().binning, 1);
  EXPECT_LT(rms_error_gsd(result.surface.depth, station.truth, station.prior.camera),
            0.3 * rms_error_gsd(station.prior.depth, station.truth, station.prior.camera));
}

}  // namespace
}  // namespace malus
