#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>

#include "malus/core/error.h"
#include "malus/fusion/refine_internal.h"
#include "malus/fusion/refinement_field_internal.h"
#include "malus/fusion/refinement_verdict_internal.h"
#include "malus/fusion/tile_solver_internal.h"
#include "quick_refinement.h"
#include "synthetic_station.h"

namespace malus {
namespace {

double largest_difference_gsd(const Image<float>& a, const Image<float>& b) {
  double largest = 0;
  for (std::size_t i = 0; i < a.count(); ++i) {
    if (std::isfinite(a[i])) largest = std::max(largest, std::abs(static_cast<double>(a[i]) - b[i]) / station_gsd_mm);
  }
  return largest;
}

TEST(Refine, FindsTheBumpsOfADiffuseSurface) {
  SyntheticOptions scene;
  scene.model.environment.radiance.fill(0.1);
  const SyntheticStation station = make_station(scene);
  const RefineResult result = refine(station.state, station.prior, {}, quick(), Context{});
  const double before = rms_error_gsd(station.prior.depth, station.truth, station.prior.camera);
  const double after = rms_error_gsd(result.surface.depth, station.truth, station.prior.camera);
  EXPECT_GT(before, 0.6);
  EXPECT_LT(after, 0.3 * before);
  EXPECT_EQ(result.report.specular_share, 0);
  EXPECT_EQ(result.surface.method, Fusion::refined);
  EXPECT_EQ(result.surface.status, FusionStatus::converged);
  EXPECT_EQ(result.report.iterations.size(), 2u);
}

TEST(Refine, FindsTheBumpsOfASpecularSurface) {
  SyntheticOptions scene;
  scene.kind = Reflection::specular;
  scene.model.mirror = {0.12, 13};
  const SyntheticStation station = make_station(scene);
  RefineOptions options = quick();
  options.iterations = 6;
  const RefineResult result = refine(station.state, station.prior, {}, options, Context{});
  EXPECT_EQ(result.report.specular_share, 1);
  double error = 0, mirrored = 0;
  for (std::size_t i = 0; i < station.truth.count(); ++i) {
    const double truth = station.state.i_un[i] - 0.5 * scene.model.mirror.body;
    error += std::abs(result.report.mirrored[i] - truth);
    mirrored += truth;
  }
  EXPECT_LT(error, 0.15 * mirrored) << "all light but that of the body is mirrored";
  EXPECT_LT(rms_error_gsd(result.surface.depth, station.truth, station.prior.camera),
            0.35 * rms_error_gsd(station.prior.depth, station.truth, station.prior.camera));
}

TEST(Refine, NoRoundFollowsASearchThatTookNothingOnceTheSurfaceHadSettled) {
  SyntheticOptions scene;
  scene.kind = Reflection::specular;
  scene.model.mirror = {0.12, 13};
  SyntheticStation station = make_station(scene);
  station.prior.depth = station.truth;
  RefineInput input;
  input.reflection = ReflectionChoice::specular;
  RefineOptions options = quick();
  options.search = true;
  options.search_sharpening = 10;  // a start from which the search goes on for longer than it may
  const RefineReport report = refine(station.state, station.prior, input, options, Context{}).report;
  ASSERT_EQ(report.regions_taken, 0);
  ASSERT_LT(last_round(report).change_gsd, 0.5);
  EXPECT_TRUE(report.iterations.back().search);
  EXPECT_GT(report.iterations.back().change_gsd, 0.5) << "the reason for this test";
}

TEST(Refine, SearchesOnTheObjectOnly) {
  SyntheticOptions scene;
  scene.kind = Reflection::specular;
  scene.model.mirror = {0.12, 13};
  scene.size = {112, 96};
  SyntheticStation station = make_station(scene);
  const PixelRect object{21, 13, 77, 69};
  for (int v = 0; v < scene.size.height; ++v) {
    for (int u = 0; u < scene.size.width; ++u) {
      if (u < object.u0 || v < object.v0 || u >= object.u1 || v >= object.v1)
        station.state.valid(u, v) = static_cast<std::uint8_t>(PixelState::outside);
    }
  }
  RefineOptions options = quick();
  options.search = true;
  const RefineResult result = refine(station.state, station.prior, {}, options, Context{});
  EXPECT_TRUE(std::ranges::any_of(result.report.iterations, &RefineIteration::search));
  for (int v = 0; v < scene.size.height; ++v) {
    for (int u = 0; u < scene.size.width; ++u) {
      const bool is_object = u >= object.u0 && v >= object.v0 && u < object.u1 && v < object.v1;
      ASSERT_EQ(std::isfinite(result.surface.depth(u, v)), is_object);
    }
  }
  const Pinhole camera = station.prior.camera.cropped(object);
  const Image<float> truth = cropped(station.truth, object);
  EXPECT_LT(rms_error_gsd(cropped(result.surface.depth, object), truth, camera),
            rms_error_gsd(cropped(station.prior.depth, object), truth, camera));
}

TEST(Refine, ContinuesWhileTheSurfaceChanges) {
  SyntheticOptions scene;
  scene.model.environment.radiance.fill(0.1);
  scene.bump_gsd = 3.5;
  SyntheticStation station = make_station(scene);
  for (float& sigma : station.prior.sigma) sigma *= 10;
  RefineOptions options = quick();
  options.surroundings = false;
  options.evidence = false;  // evidence would reject the surface: the prior is too far off
  const RefineResult result = refine(station.state, station.prior, {}, options, Context{});
  options.more_iterations = 0;
  const RefineResult short_one = refine(station.state, station.prior, {}, options, Context{});
  EXPECT_EQ(short_one.report.iterations.size(), 2u);
  EXPECT_GT(short_one.report.iterations.back().change_gsd, 0.5);
  EXPECT_GT(result.report.iterations.size(), 2u);
  const Pinhole& camera = station.prior.camera;
  EXPECT_LT(rms_error_gsd(result.surface.depth, station.truth, camera),
            0.9 * rms_error_gsd(short_one.surface.depth, station.truth, camera));
}

TEST(Refine, DoesNotDependOnTheNumberOfThreads) {
  SyntheticOptions scene;
  scene.size = {112, 96};
  const SyntheticStation station = make_station(scene);
  RefineOptions options;
  options.tile_px = 64;
  options.margin_px = 16;
  options.iterations = 2;
  const Context one{}, three{.threads = 3};
  const RefineResult a = refine(station.state, station.prior, {}, options, one);
  const RefineResult b = refine(station.state, station.prior, {}, options, three);
  EXPECT_EQ(a.report.tiles, 4);
  EXPECT_LT(largest_difference_gsd(a.surface.depth, b.surface.depth), 1e-4);
}

TEST(Refine, CountsTheTilesThatHoldTheObject) {
  SyntheticOptions scene;
  scene.size = {112, 96};
  SyntheticStation station = make_station(scene);
  for (int v = 0; v < 96; ++v) {
    for (int u = 0; u < 112; ++u)
      if (u >= 30 || v >= 30) station.state.valid(u, v) = static_cast<std::uint8_t>(PixelState::outside);
  }
  RefineOptions options = quick();
  options.tile_px = 64;
  options.margin_px = 16;
  const RefineReport report = refine(station.state, station.prior, {}, options, Context{}).report;
  EXPECT_EQ(report.tiles, 4);
  EXPECT_EQ(report.iterations.back().tiles, 1);
}

TEST(Refine, StatisticsOfTilesAreSummed) {
  const SolveStatistics tile{
      .cost_before = 5, .cost_after = 3, .accepted_steps = 1, .rejected_steps = 2, .failed_tiles = 1, .tiles = 1};
  SolveStatistics sum;
  sum += tile;
  sum += tile;
  EXPECT_EQ(sum.cost_before, 10);
  EXPECT_EQ(sum.cost_after, 6);
  EXPECT_EQ(sum.accepted_steps, 2);
  EXPECT_EQ(sum.rejected_steps, 4);
  EXPECT_EQ(sum.failed_tiles, 2);
  EXPECT_EQ(sum.tiles, 2);
}

TEST(Refine, TilesLeaveNoSeam) {
  SyntheticOptions scene;
  scene.size = {160, 56};
  const SyntheticStation station = make_station(scene);
  RefineOptions whole = quick(), tiled = quick();
  whole.tile_px = 512;
  tiled.tile_px = 88;
  tiled.margin_px = 32;
  const RefineResult a = refine(station.state, station.prior, {}, whole, Context{});
  const RefineResult b = refine(station.state, station.prior, {}, tiled, Context{});
  EXPECT_EQ(a.report.tiles, 1);
  EXPECT_EQ(b.report.tiles, 2);
  // The difference from the solution in one tile must not jump at the border between the tiles.
  double jump = 0;
  for (int v = 0; v < scene.size.height; ++v) {
    for (int u = 60; u < 110; ++u) {
      const auto difference = [&](int at) {
        return (b.surface.depth(at, v) - a.surface.depth(at, v)) / station_gsd_mm;
      };
      jump = std::max(jump, std::abs(static_cast<double>(difference(u + 1) - difference(u))));
    }
  }
  EXPECT_LT(jump, 0.01);
}

TEST(Refine, ResultInStripsEqualsResultInOnePiece) {
  for (const Reflection kind : {Reflection::diffuse, Reflection::specular}) {
    SyntheticOptions scene;
    scene.size = {80, 200};
    scene.kind = kind;
    scene.model.environment.radiance.fill(0.1);
    scene.model.mirror = {0.15, 14};
    SyntheticStation station = make_station(scene);
    station.state.valid(30, 130) = static_cast<std::uint8_t>(PixelState::outside);
    RefineOptions options = quick();
    options.tile_px = 64;
    options.margin_px = 16;
    options.regional_weights = true;
    options.strip_megapixels = 1;
    const RefineResult whole = refine(station.state, station.prior, {}, options, Context{});
    options.strip_megapixels = 0.01;
    const RefineResult strips = refine(station.state, station.prior, {}, options, Context{});
    EXPECT_GT(whole.report.tiles, 4);
    EXPECT_NEAR(strips.report.median_residual, whole.report.median_residual, 1e-6);
    EXPECT_EQ(strips.report.label, whole.report.label);
    const double pixel = station.prior.depth(40, 100) / station.prior.camera.focal();
    for (std::size_t i = 0; i < station.truth.count(); ++i) {
      if (std::isnan(whole.surface.depth[i])) continue;
      ASSERT_NEAR(strips.surface.depth[i], whole.surface.depth[i], 1e-3 * pixel);
      ASSERT_NEAR(strips.surface.sigma[i], whole.surface.sigma[i], 1e-3 * pixel);
      ASSERT_NEAR(strips.report.confidence[i], whole.report.confidence[i], 1);
    }
  }
}

TEST(Refine, SigmaIsPositiveAndCoversTheError) {
  SyntheticOptions scene;
  scene.model.environment.radiance.fill(0.1);
  const SyntheticStation station = make_station(scene);
  const RefineResult result = refine(station.state, station.prior, {}, quick(), Context{});
  double covered = 0, count = 0;
  for (std::size_t i = 0; i < station.truth.count(); ++i) {
    ASSERT_GT(result.surface.sigma[i], 0);
    covered += std::abs(result.surface.depth[i] - station.truth[i]) < 2 * result.surface.sigma[i];
    ++count;
  }
  EXPECT_GT(covered / count, 0.9);
}

/// How far an object is from a shape, or from depths whose errors are no noise, does not average out.
TEST(Refine, SigmaIsNowhereBelowASystematicErrorOfThePrior) {
  SyntheticOptions scene;
  scene.model.environment.radiance.fill(0.1);
  SyntheticStation station = make_station(scene);
  ASSERT_EQ(station.prior.noise, 0);
  const auto smallest_share = [&] {
    const Image<float> sigma = refine(station.state, station.prior, {}, quick(), Context{}).surface.sigma;
    float smallest = std::numeric_limits<float>::infinity();
    for (std::size_t i = 0; i < sigma.count(); ++i) smallest = std::min(smallest, sigma[i] / station.prior.sigma[i]);
    return smallest;
  };
  EXPECT_GE(smallest_share(), 1);
  station.prior.noise = 0.5 * station_gsd_mm;
  EXPECT_LT(smallest_share(), 0.9) << "noise averages out";
}

TEST(Refine, PixelsOutsideTheObjectStayEmpty) {
  SyntheticStation station = make_station({});
  for (int v = 20; v < 40; ++v) {
    for (int u = 33; u < 36; ++u) station.state.valid(u, v) = 0;
  }
  station.prior.depth(50, 30) = std::numeric_limits<float>::quiet_NaN();
  const RefineResult result = refine(station.state, station.prior, {}, quick(), Context{});
  EXPECT_TRUE(std::isnan(result.surface.depth(34, 30)));
  EXPECT_TRUE(std::isnan(result.surface.depth(50, 30)));
  EXPECT_TRUE(std::isfinite(result.surface.depth(51, 30)));
  EXPECT_EQ(result.report.label(34, 30), 0);
  EXPECT_EQ(result.report.confidence(34, 30), 0);
}

TEST(Refine, WarnsOfMetal) {
  SyntheticOptions scene;
  scene.kind = Reflection::specular;
  scene.model.mirror = {0.9, 4};  // phase of specular reflection, degree far below a dielectric's
  const SyntheticStation station = make_station(scene);
  const RefineResult result = refine(station.state, station.prior, {}, quick(), Context{});
  EXPECT_NE(result.surface.confidence.level, ConfidenceLevel::high);
  EXPECT_TRUE(std::ranges::any_of(result.surface.confidence.reasons, [](const std::string& reason) {
    return reason.find("bare metal") != std::string::npos;
  }));
  EXPECT_EQ(result.report.trusted_share, 0) << "the surface stays the prior's";
}

/// A body with this refractive index and a prior whose slopes are accurate enough to estimate the index.
SyntheticStation body_of_index(double eta) {
  SyntheticOptions scene;
  scene.bump_gsd = 0.2;
  scene.model.eta = eta;
  return make_station(scene);
}

bool warns_of(const RefineResult& result, const std::string& words) {
  return std::ranges::any_of(result.surface.warnings,
                             [&](const std::string& warning) { return warning.find(words) != std::string::npos; });
}

TEST(Refine, EstimatesTheRefractiveIndex) {
  for (const double eta : {1.4, 1.65, 1.85}) {
    const SyntheticStation station = body_of_index(eta);
    RefineInput input;
    input.refractive_index.reset();
    const RefineResult result = refine(station.state, station.prior, input, quick(), Context{});
    EXPECT_NEAR(result.report.reflection.eta, eta, 0.1);
    EXPECT_GT(result.report.eta_sigma, 0);
    EXPECT_FALSE(result.report.stated_eta);
    EXPECT_FALSE(warns_of(result, "refractive"));
  }
}

TEST(Refine, RejectsAnIndexAtTheEndOfTheRange) {
  const SyntheticStation station = body_of_index(2.6);
  RefineInput input;
  input.refractive_index.reset();
  RefineOptions options = quick();
  options.surroundings = false;
  const RefineResult result = refine(station.state, station.prior, input, options, Context{});
  EXPECT_EQ(result.report.reflection.eta, 1.5);
  EXPECT_TRUE(std::isnan(result.report.eta_sigma));
  EXPECT_TRUE(warns_of(result, "refractive index is not known"));
}

TEST(Refine, ReplacesAStatedIndexThatIsContradicted) {
  const SyntheticStation station = body_of_index(1.85);
  RefineOptions options = quick();
  options.surroundings = false;
  const RefineResult corrected = refine(station.state, station.prior, {}, options, Context{});
  EXPECT_NEAR(corrected.report.reflection.eta, 1.85, 0.1);
  EXPECT_EQ(corrected.report.stated_eta, 1.5);
  EXPECT_GT(corrected.report.eta_sigma, 0);
  EXPECT_TRUE(warns_of(corrected, "contradicts optics.refractive_index = 1.5"));
  options.correct_index = false;
  const RefineResult as_stated = refine(station.state, station.prior, {}, options, Context{});
  EXPECT_EQ(as_stated.report.reflection.eta, 1.5);
  EXPECT_FALSE(as_stated.report.stated_eta);
}

TEST(Refine, KeepsAStatedIndexThatIsNotContradicted) {
  const SyntheticStation station = body_of_index(1.5);
  const RefineReport report = refine(station.state, station.prior, {}, quick(), Context{}).report;
  EXPECT_EQ(report.reflection.eta, 1.5) << "exactly the stated index";
  EXPECT_FALSE(report.stated_eta);
  EXPECT_EQ(report.eta_sigma, 0);
}

TEST(Refine, UsesGivenLabels) {
  const SyntheticStation station = make_station({});
  RefineInput input;
  input.reflection = ReflectionChoice::labels;
  input.labels = Mask(station.state.size(), 1, 2);
  RefineOptions options = quick();
  options.iterations = 1;
  EXPECT_EQ(refine(station.state, station.prior, input, options, Context{}).report.specular_share, 1);
  input.labels(3, 3) = 7;
  EXPECT_THROW(refine(station.state, station.prior, input, options, Context{}), Error);
  input.labels = Mask({3, 3});
  EXPECT_THROW(refine(station.state, station.prior, input, options, Context{}), Error);
}

TEST(Refine, RejectsAnIndexThatStationFilesCannotHave) {
  const SyntheticStation station = make_station({});
  for (const double eta : {1.0, 3.2}) {
    RefineInput input;
    input.refractive_index = eta;
    EXPECT_THROW(refine(station.state, station.prior, input, {}, Context{}), Error);
  }
}

TEST(Refine, RejectsMismatchedInputsAndInvalidOptions) {
  const SyntheticStation station = make_station({});
  DepthPrior other = station.prior;
  other.depth = Image<float>({10, 10}, 1, 500);
  EXPECT_THROW(refine(station.state, other, {}, {}, Context{}), Error);
  other = station.prior;
  other.depth.fill(std::numeric_limits<float>::quiet_NaN());
  EXPECT_THROW(refine(station.state, other, {}, {}, Context{}), Error);
  RefineOptions options;
  options.tile_px = 1;
  EXPECT_THROW(refine(station.state, station.prior, {}, options, Context{}), Error);
}

TEST(Refine, DoesNotTrustASurfaceFartherFromACloudThanItsErrors) {
  SyntheticStation station = make_station({});
  for (float& sigma : station.prior.sigma) sigma *= 0.02F;
  const RefineResult of_a_mesh = refine(station.state, station.prior, {}, quick(), Context{});
  EXPECT_GT(of_a_mesh.report.trusted_share, 0.5) << "the errors of a mesh are only assumed";
  station.prior.smoothing_px = 4;
  const RefineResult of_a_cloud = refine(station.state, station.prior, {}, quick(), Context{});
  EXPECT_LT(of_a_cloud.report.trusted_share, 0.5);
}

TEST(Refine, StopsWhenCanceled) {
  const SyntheticStation station = make_station({});
  const std::atomic<bool> cancel = true;
  Context context;
  context.cancel = &cancel;
  EXPECT_THROW(refine(station.state, station.prior, {}, {}, context), Error);
}

TEST(Tiles, AnImageOfOneTileIsHalvedIfLargeComparedWithTheMargin) {
  const std::vector<Tile> wide = divide_into_tiles({360, 200}, 384, 32);
  ASSERT_EQ(wide.size(), 2u);
  EXPECT_EQ(wide[0].core.height(), 200);
  EXPECT_NEAR(wide[0].core.width(), 180, prior_block_px);
  const std::vector<Tile> tall = divide_into_tiles({200, 360}, 384, 32);
  ASSERT_EQ(tall.size(), 2u);
  EXPECT_EQ(tall[1].core.width(), 200);
  EXPECT_EQ(divide_into_tiles({200, 200}, 384, 32).size(), 1u);
}

TEST(Tiles, StripsConsistOfWholeRowsOfTiles) {
  const Size size{413, 251};
  const std::vector<Tile> tiles = divide_into_tiles(size, 64, 16);
  ASSERT_EQ(tiles.size(), 28u);
  for (const auto& [strip_px, count] : {std::pair{1e6, 1}, {6e4, 2}, {4e4, 3}, {1.0, 4}}) {
    const std::vector<TileStrip> strips = divide_into_strips(tiles, size, strip_px);
    EXPECT_EQ(strips.size(), static_cast<std::size_t>(count));
    int row = 0;
    std::size_t next = 0;
    for (const TileStrip& strip : strips) {
      EXPECT_EQ(strip.rows.begin, row);
      row = strip.rows.end;
      for (const Tile& tile : strip.tiles) {
        EXPECT_EQ(tile.core, tiles[next++].core);
        EXPECT_GE(tile.core.v0, strip.rows.begin);
        EXPECT_LE(tile.core.v1, strip.rows.end);
      }
    }
    EXPECT_EQ(row, size.height);
    EXPECT_EQ(next, tiles.size());
  }
}

TEST(Tiles, CoverTheImageOnceOnBlockBorders) {
  const Size size{413, 251};
  const std::vector<Tile> tiles = divide_into_tiles(size, 100, 20);
  Image<int> covered(size);
  for (const Tile& tile : tiles) {
    EXPECT_EQ(tile.core.u0 % prior_block_px, 0);
    EXPECT_EQ(tile.outer.v0 % prior_block_px, 0);
    EXPECT_LE(tile.core.width(), 108);
    for (int v = tile.core.v0; v < tile.core.v1; ++v) {
      for (int u = tile.core.u0; u < tile.core.u1; ++u) ++covered(u, v);
    }
  }
  for (const int count : covered) EXPECT_EQ(count, 1);
}

}  // namespace
}  // namespace malus
