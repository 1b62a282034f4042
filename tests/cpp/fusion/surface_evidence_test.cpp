#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "malus/fusion/refine_internal.h"
#include "malus/fusion/refinement_weights_internal.h"
#include "malus/fusion/slow_waves_internal.h"
#include "malus/fusion/surface_evidence_internal.h"
#include "quick_refinement.h"
#include "synthetic_station.h"

namespace malus {
namespace {

SyntheticOptions scene_under_a_sky() {
  SyntheticOptions scene;
  scene.size = {160, 128};
  scene.model.environment.radiance.fill(0.1);
  return scene;
}

/// Turns the direction of polarization in all columns from `first` on, against the reflection model.
void turn_phase(PolarizationState& state, int first, double angle_rad) {
  for (int v = 0; v < state.size().height; ++v) {
    for (int u = first; u < state.size().width; ++u) state.phi(u, v) += static_cast<float>(angle_rad);
  }
}

double rms_of_columns(const Image<float>& depth, const Image<float>& truth, int begin, int end) {
  double sum = 0, squares = 0, count = 0;
  for (int v = 4; v < truth.height() - 4; ++v) {
    for (int u = begin; u < end; ++u) {
      const double error = (static_cast<double>(depth(u, v)) - truth(u, v)) / station_gsd_mm;
      sum += error;
      squares += error * error;
      ++count;
    }
  }
  return std::sqrt(squares / count - sum * sum / (count * count));
}

constexpr double misleading = 0.45;  // rad
const RefineInput diffuse{1.5, ReflectionChoice::diffuse, {}};

TEST(Evidence, AModelThatHoldsIsTrustedEverywhere) {
  const SyntheticStation station = make_station(scene_under_a_sky());
  const RefineResult result = refine(station.state, station.prior, {}, quick(), Context{});
  EXPECT_GT(result.report.explained_share, 0.6);
  EXPECT_GT(result.report.trusted_share, 0.9);
  EXPECT_EQ(result.surface.confidence.level, ConfidenceLevel::high);
  EXPECT_TRUE(result.surface.confidence.reasons.empty());
}

TEST(Evidence, ThePriorIsKeptWhereTheModelCannotExplainThePolarization) {
  SyntheticStation station = make_station(scene_under_a_sky());
  turn_phase(station.state, 0, misleading);
  RefineOptions options = quick();
  const RefineResult held = refine(station.state, station.prior, diffuse, options, Context{});
  options.evidence = false;
  const RefineResult free = refine(station.state, station.prior, diffuse, options, Context{});
  const double prior = rms_error_gsd(station.prior.depth, station.truth, station.prior.camera);
  EXPECT_GT(rms_of_columns(free.surface.depth, station.prior.depth, 4, 156), 0.3)
      << "without evidence, the surface leaves the prior";
  EXPECT_LT(rms_error_gsd(held.surface.depth, station.truth, station.prior.camera), 1.02 * prior);
  EXPECT_NE(free.surface.confidence.level, ConfidenceLevel::high) << "the evidence was not evaluated";
  EXPECT_TRUE(std::isnan(free.report.trusted_share) && std::isnan(free.report.explained_share));
  EXPECT_TRUE(free.report.trust.empty()) << "without evidence there is no trust map";
  EXPECT_LT(held.report.trusted_share, 0.05);
  EXPECT_EQ(held.surface.confidence.level, ConfidenceLevel::partial);
  ASSERT_FALSE(held.surface.confidence.reasons.empty());
  // The result is as uncertain as the prior.
  EXPECT_NEAR(held.surface.sigma(80, 64) / station.prior.sigma(80, 64), 1, 0.05);
}

TEST(Evidence, WithoutAnyUsablePixelThePriorStays) {
  SyntheticStation station = make_station(scene_under_a_sky());
  station.state.valid.fill(static_cast<std::uint8_t>(PixelState::saturated));
  const RefineResult result = refine(station.state, station.prior, {}, quick(), Context{});
  EXPECT_LT(result.report.trusted_share, 0.05);
  EXPECT_NE(result.surface.confidence.level, ConfidenceLevel::high);
  EXPECT_NEAR(result.surface.depth(80, 64), station.prior.depth(80, 64), 1e-3);
}

TEST(Evidence, OnlyUsablePixelsAreTrusted) {
  SyntheticOptions scene = scene_under_a_sky();
  scene.size = {320, 128};
  SyntheticStation station = make_station(scene);
  // The left half is misleading. Of the right half, only the columns farthest from it (from 280 on) are usable.
  turn_phase(station.state, 0, misleading);
  for (int v = 0; v < 128; ++v) {
    for (int u = 160; u < 320; ++u) {
      station.state.phi(u, v) -= static_cast<float>(misleading);
      if (u < 280) station.state.valid(u, v) = static_cast<std::uint8_t>(PixelState::saturated);
    }
  }
  const RefineResult result = refine(station.state, station.prior, diffuse, quick(), Context{});
  EXPECT_LT(result.report.trust(80, 64), 60);
  EXPECT_GT(result.report.trust(300, 64), 200);
  EXPECT_NEAR(result.report.trusted_share, 0.2, 0.1) << "40 of 200 usable columns; the columns between do not count";
}

TEST(Evidence, AFlatObjectGivesNoEvidenceOfItsRelief) {
  SyntheticOptions scene = scene_under_a_sky();
  scene.bump_gsd = 0.02;
  scene.flat = true;
  const SyntheticStation station = make_station(scene);
  const RefineResult result = refine(station.state, station.prior, diffuse, quick(), Context{});
  EXPECT_GT(result.report.explained_share, 0.9) << "a plane explains all the polarization";
  EXPECT_LT(result.report.explained_beyond_plane, 0.2);
  EXPECT_EQ(result.surface.confidence.level, ConfidenceLevel::partial);
}

TEST(Evidence, IsWeighedRegionByRegion) {
  SyntheticOptions scene = scene_under_a_sky();
  scene.size = {400, 96};
  SyntheticStation station = make_station(scene);
  constexpr int border = 300, far = 80;  // `far` from the border: farther than the pooling reaches
  turn_phase(station.state, border, misleading);
  const RefineResult result = refine(station.state, station.prior, diffuse, quick(), Context{});
  EXPECT_EQ(result.report.trust(border - far, 64), 255);
  EXPECT_EQ(result.report.trust(border + far, 64), 0);
  EXPECT_NE(result.surface.confidence.level, ConfidenceLevel::high);
  EXPECT_LT(rms_of_columns(result.surface.depth, station.truth, 8, border - far),
            0.7 * rms_of_columns(station.prior.depth, station.truth, 8, border - far));
  EXPECT_LT(rms_of_columns(result.surface.depth, station.truth, border + far, 392),
            1.05 * rms_of_columns(station.prior.depth, station.truth, border + far, 392));
}

/// A surface that is far from a depth map, in its stated standard deviations, is not better than the map.
TEST(Evidence, SurfacesStayAsNearToADepthMapAsItsStatedErrorsAllow) {
  SyntheticStation station = make_station(scene_under_a_sky());
  const auto error = [&](const Image<float>& depth) { return rms_of_columns(depth, station.truth, 8, 152); };
  const double of_prior = error(station.prior.depth);
  const auto with_sigma = [&](double sigma_gsd) {
    const double sigma = sigma_gsd * station_gsd_mm;
    station.prior.noise = sigma;
    station.prior.spacing_px = 4;
    station.prior.sigma = Image<float>(station.prior.depth.size(), 1, static_cast<float>(sigma));
    return error(refine(station.state, station.prior, diffuse, quick(), Context{}).surface.depth);
  };
  EXPECT_LT(with_sigma(1.2 * of_prior), 0.75 * of_prior);
  EXPECT_GT(with_sigma(of_prior / 3), 0.95 * of_prior);
}

/// Relief that the prior lacks is the object's only if the object has each normal in places that far apart.
TEST(Evidence, NothingIsGainedWhereThePriorLacksMoreThanTheShapeTells) {
  SyntheticStation station = make_station(scene_under_a_sky());
  const auto refined_with = [&](double smoothing_px) {
    station.prior.smoothing_px = smoothing_px;
    return refine(station.state, station.prior, diffuse, quick(), Context{});
  };
  const RefineResult told = refined_with(1), untold = refined_with(100);
  EXPECT_EQ(told.report.shape_share, 1);
  EXPECT_GT(told.report.trusted_share, 0.9);
  EXPECT_EQ(untold.report.shape_share, 0);
  EXPECT_EQ(untold.report.trusted_share, 0);
  EXPECT_NEAR(rms_of_columns(untold.surface.depth, station.prior.depth, 8, 152), 0, 0.01);
}

TEST(Evidence, SlowWavesAreShrunkByThePriorsVarianceAndDetailStays) {
  SyntheticStation station = make_station(scene_under_a_sky());
  constexpr double sigma_gsd = 0.5, smoothing_px = 2;
  station.prior.sigma = Image<float>(station.prior.depth.size(), 1, static_cast<float>(sigma_gsd * station_gsd_mm));
  RefinementImage image = make_image(station.state, station.prior, Context{});
  const Image<double> prior = image.x;
  const double sigma = image.source(80, 64).prior_sigma;
  const auto moved = [&](double offset) {
    for (int v = 0; v < image.size().height; ++v) {
      for (int u = 0; u < image.size().width; ++u) image.x(u, v) = prior(u, v) + offset + 0.4 * sigma * (u % 2);
    }
    shrink_slow_waves(image, prior, smoothing_px, Context{});
    return Eigen::Vector2d(image.x(80, 64) - prior(80, 64), image.x(81, 64) - prior(81, 64));
  };
  // The even columns' movement and half of the odd ones' is the slow part.
  for (const double offset : {0.5, 1.8, 4.8}) {
    const double slow = offset + 0.2, share = std::min(1.0, 1 / (slow * slow));
    const Eigen::Vector2d now = moved(offset * sigma) / sigma;
    EXPECT_NEAR(now.mean(), share * slow, 0.01) << offset;
    EXPECT_NEAR(now.y() - now.x(), 0.4, 0.01) << offset;
  }
}

/// The image as a diffuse body under the scene's light.
RefinementField diffuse_field(RefinementImage& image) {
  image.kind.fill(Reflection::diffuse);
  image.reflection = scene_under_a_sky().model;
  return image.part(image.everything(), Context{});
}

/// Puts factor(u, v) times the predicted polarization in place of the measured one.
template <class Factor>
void measure(RefinementField& field, Factor factor) {
  for (int v = 0; v < field.size().height; ++v) {
    for (int u = 0; u < field.size().width; ++u) {
      const Slopes slopes = central_slopes(field, u, v);
      const PredictedStokes model = field.reflection_at(u, v).predict(slopes.p, slopes.q);
      field.s1(u, v) = factor(u, v) * static_cast<float>(model.s1);
      field.s2(u, v) = factor(u, v) * static_cast<float>(model.s2);
    }
  }
}

TEST(Evidence, SharesAreOneForThePredictionAndNegativeForItsOpposite) {
  const SyntheticStation station = make_station(scene_under_a_sky());
  RefinementImage image = make_image(station.state, station.prior, Context{});
  RefinementField field = diffuse_field(image);
  measure(field, [](int u, int) { return u < 80 ? 1.0F : -1.0F; });
  ExplainedPolarization explained(field.size(), {0, 0, -1});
  explained.add(field, {0, 48}, 0, Context{});  // two parts that share a row of cells
  explained.add(field, {48, 129}, 0, Context{});
  const Image<float> shares = explained.shares(false, Context{});
  ASSERT_EQ(shares.width(), 11);  // the last node begins one more cell
  ASSERT_EQ(shares.height(), 9);
  EXPECT_GT(shares(0, 4), 0.95);
  EXPECT_LT(shares(9, 4), -0.55);  // residual r = 2 s gives 1 - 2 · 4 / 5 = -0.6
}

TEST(Evidence, ResidualsOfTheResultAreMediansOfEachCell) {
  const SyntheticStation station = make_station(scene_under_a_sky());
  RefinementImage image = make_image(station.state, station.prior, Context{});
  RefinementField field = diffuse_field(image);
  // In the left half all but one pixel in nine are explained; in the right half the residual is a fifth of the
  // measurement.
  measure(field, [](int u, int v) {
    const float wild = u % 3 == 0 && v % 3 == 0 ? 5.0F : 1.0F;
    return u < 80 ? wild : 1.25F;
  });
  ExplainedByResult explained(field.size());
  explained.add(field, {0, 48}, 0, Context{});
  explained.add(field, {48, 129}, 0, Context{});
  const Image<float> shares = explained.shares(Context{});
  EXPECT_NEAR(shares(1, 4), 1, 0.01);
  EXPECT_NEAR(shares(8, 4), 0.8, 0.02);
}

TEST(Evidence, BothPartsOfACutCellCount) {
  const SyntheticStation station = make_station(scene_under_a_sky());
  RefinementImage image = make_image(station.state, station.prior, Context{});
  RefinementField field = diffuse_field(image);
  constexpr int border = 56;  // in the middle of the fourth row of cells
  // Above the border nothing of the measurement is explained, below it everything.
  measure(field, [](int, int v) { return v < border ? -1.0F : 1.0F; });
  ExplainedByResult explained(field.size());
  explained.add(field, {0, border}, 0, Context{});
  explained.add(field, {border, 129}, 0, Context{});
  const Image<float> shares = explained.shares(Context{});
  EXPECT_NEAR(shares(5, 1), -1, 0.05);
  EXPECT_NEAR(shares(5, 3), 0, 0.15) << "1 where only the later part counts";
  EXPECT_NEAR(shares(5, 6), 1, 0.05);
}

TEST(Evidence, CellsAreInterpolatedBetweenTheirCenters) {
  Image<float> cells({3, 1});
  cells(0, 0) = 1;
  cells(1, 0) = 3;
  cells(2, 0) = 7;
  EXPECT_DOUBLE_EQ(between_cells(cells, 4, 0, 0), 1);  // before the first center
  EXPECT_NEAR(between_cells(cells, 4, 3, 1), 1 + 2 * (3.5 / 4 - 0.5), 1e-9);
  EXPECT_NEAR(between_cells(cells, 4, 9, 2), 3 + 4 * (9.5 / 4 - 1.5), 1e-9);
  EXPECT_DOUBLE_EQ(between_cells(cells, 4, 11, 3), 7);  // beyond the last center
}

TEST(Evidence, TheAnchorTakesLowFrequenciesFromThePriorAndLeavesDetail) {
  const SyntheticStation station = make_station(scene_under_a_sky());
  RefinementImage image = make_image(station.state, station.prior, Context{});
  const Image<double> prior = image.x;
  const Size size = image.size();
  for (const double length : {3.0, 12.0}) {  // the first is shorter than a block of the prior
    for (int v = 0; v < size.height; ++v) {
      for (int u = 0; u < size.width; ++u) image.x(u, v) = prior(u, v) + 2 + std::sin(1.2 * u);
    }
    anchor_to_prior(image, prior, length, Context{});
    double largest_offset = 0, detail = 0;
    for (int u = 40; u < 120; ++u) {
      const double change = image.x(u, 64) - prior(u, 64);
      largest_offset = std::max(largest_offset, std::abs(change - std::sin(1.2 * u)));
      detail = std::max(detail, std::abs(change));
    }
    EXPECT_LT(largest_offset, 0.1) << length;
    EXPECT_GT(detail, 0.9) << length;
  }
}

TEST(Evidence, TheAnchorWeightsThePriorByItsInverseVariance) {
  SyntheticStation station = make_station(scene_under_a_sky());
  constexpr double length = 12;
  constexpr int unknown = 80;  // the prior is unknown from this column on
  for (int v = 0; v < station.prior.sigma.height(); ++v) {
    for (int u = unknown; u < station.prior.sigma.width(); ++u) station.prior.sigma(u, v) *= 20;
  }
  RefinementImage image = make_image(station.state, station.prior, Context{});
  const Image<double> before = image.x;
  Image<double> prior = image.x;
  for (int v = 0; v < image.size().height; ++v) {
    for (int u = unknown; u < image.size().width; ++u) prior(u, v) += 20;
  }
  anchor_to_prior(image, prior, length, Context{});
  EXPECT_LT(image.x(72, 64) - before(72, 64), 2);  // 5 with equal weights
  EXPECT_NEAR(image.x(140, 64) - before(140, 64), 20, 0.5);
}

}  // namespace
}  // namespace malus
