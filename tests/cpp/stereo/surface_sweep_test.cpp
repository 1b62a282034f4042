#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "malus/core/error.h"
#include "malus/stereo/surface_sweep_internal.h"
#include "stereo/sweep_scenes.h"
#include "thrown_error.h"

namespace malus {
namespace {

using namespace sweep_scenes;

struct Errors {
  double completeness = 0, median_gsd = 0, rms_gsd = 0, within_2_sigma = 0;
};

/// Errors of the pixels at least `border` px inside the image.
Errors errors_of(const SweepResult& result, const Image<double>& truth, int border = 6) {
  std::vector<double> errors;
  double squares = 0, covered = 0, pixels = 0;
  for (int v = border; v < truth.height() - border; ++v) {
    for (int u = border; u < truth.width() - border; ++u) {
      ++pixels;
      if (!std::isfinite(result.depth(u, v))) continue;
      const double error = std::abs(result.depth(u, v) - truth(u, v));
      errors.push_back(error / gsd_mm);
      squares += std::pow(error / gsd_mm, 2);
      covered += error <= 2 * result.sigma(u, v) ? 1 : 0;
    }
  }
  if (errors.empty()) return {};
  const auto n = static_cast<double>(errors.size());
  std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2), errors.end());
  return {n / pixels, errors[errors.size() / 2], std::sqrt(squares / n), covered / n};
}

/// The scene of most tests, which is made once.
const Scene& bumpy() {
  static const Scene scene = make_scene(bumps, 6);
  return scene;
}

TEST(SurfaceSweep, FindsAPlaneThroughDistortedLenses) {
  const Scene scene = make_scene(plane, 6);
  const SweepResult result = sweep_surface(scene.input, scene.views, test_options(), {});
  const Errors errors = errors_of(result, scene.truth);
  EXPECT_GT(errors.completeness, 0.99);
  EXPECT_LT(errors.median_gsd, 0.1);
  EXPECT_LT(errors.rms_gsd, 0.25);
  EXPECT_EQ(result.views_used, 6);
  EXPECT_TRUE(result.halves_compared);
}

TEST(SweepOfBumps, FindsBumpsAndEstimatesItsError) {
  const SweepResult result = sweep_surface(bumpy().input, bumpy().views, test_options(), {});
  const Errors errors = errors_of(result, bumpy().truth);
  EXPECT_GT(errors.completeness, 0.99);
  EXPECT_LT(errors.median_gsd, 0.15);
  EXPECT_LT(errors.rms_gsd, 0.35);
  EXPECT_GT(errors.within_2_sigma, 0.85);
  EXPECT_FALSE(result.passes.empty());
  EXPECT_GT(result.median_score, 0.9);
}

TEST(SweepOfBumps, StartsFromFewRoughPoints) {
  SweepInput input = bumpy().input;
  std::vector<Eigen::Vector3d> few;
  for (std::size_t k = 0; k < input.points.size(); k += 4) few.push_back(input.points[k]);
  for (std::size_t k = 0; k < few.size(); ++k) few[k].z() += (k % 2 == 0 ? 1 : -1) * 3 * gsd_mm;
  few.push_back({0, 0, 0.7 * distance_mm});
  few.push_back({10, 10, 2 * distance_mm});
  input.points = few;
  const Errors errors = errors_of(sweep_surface(input, bumpy().views, test_options(), {}), bumpy().truth);
  EXPECT_GT(errors.completeness, 0.98);
  EXPECT_LT(errors.median_gsd, 0.15);
}

TEST(SweepOfBumps, MayAskForMorePointsThanItCompares) {
  SweepInput input = bumpy().input;
  const std::size_t given = input.points.size();
  for (std::size_t k = 0; k < 2000; ++k) input.points.push_back(bumpy().input.points[k % given]);
  SweepOptions options = test_options();
  options.min_points = 2000;
  const SweepResult result = sweep_surface(input, bumpy().views, options, {});
  EXPECT_EQ(result.points_used, 1500u);
  EXPECT_GT(result.completeness, 0.9);
}

TEST(SweepOfBumps, AKnownSurfaceReducesTheErrorsInNoise) {
  SweepInput input = bumpy().input;
  std::vector<SweepView> views = bumpy().views;
  std::mt19937 generator(5);
  std::normal_distribution<float> normal(0, 0.06F);
  for (SweepView& view : views) {
    for (float& value : view.intensity) value += normal(generator);
  }
  const Errors without = errors_of(sweep_surface(input, views, test_options(), {}), bumpy().truth);
  input.surface = input.surface_sigma = Image<float>(station_size, 1, static_cast<float>(gsd_mm));
  for (int v = 0; v < station_size.height; ++v) {
    for (int u = 0; u < station_size.width; ++u) {
      input.surface(u, v) = static_cast<float>(bumpy().truth(u, v) + 2 * gsd_mm * std::sin(u / 30.0));
    }
  }
  input.points.clear();
  const SweepResult result = sweep_surface(input, views, test_options(), {});
  const Errors errors = errors_of(result, bumpy().truth);
  EXPECT_GT(errors.completeness, 0.99);
  EXPECT_LT(errors.median_gsd, 0.8 * without.median_gsd);
  EXPECT_LT(errors.rms_gsd, 0.8 * without.rms_gsd);
  EXPECT_GT(errors.within_2_sigma, 0.85);
  EXPECT_EQ(result.passes.front().reduction, 1);
}

TEST(SweepOfBumps, SearchRangeFollowsTheSigmaOfAKnownSurface) {
  SweepInput input = bumpy().input;
  input.surface_sigma = Image<float>(station_size, 1, static_cast<float>(12 * gsd_mm));
  input.surface = Image<float>(station_size);
  for (std::size_t i = 0; i < input.surface.count(); ++i) {
    input.surface[i] = static_cast<float>(bumpy().truth[i] + 12 * gsd_mm);
  }
  input.surface(40, 40) = std::numeric_limits<float>::quiet_NaN();
  const SweepResult result = sweep_surface(input, bumpy().views, test_options(), {});
  EXPECT_EQ(result.passes.front().reduction, 2);
  EXPECT_LT(errors_of(result, bumpy().truth).median_gsd, 0.3);
}

TEST(SweepOfBumps, RejectsAKnownSurfaceWithoutDepth) {
  SweepInput input = bumpy().input;
  input.surface = input.surface_sigma = Image<float>(station_size);
  expect_error(
      ErrorCode::input, [&] { sweep_surface(input, bumpy().views, test_options(), {}); },
      "known surface: expected a depth");
  input.surface_sigma = Image<float>({3, 3}, 1, 1.0F);
  expect_error(
      ErrorCode::input, [&] { sweep_surface(input, bumpy().views, test_options(), {}); },
      "standard deviation of the known surface is 3 x 3 pixels");
}

TEST(SweepOfBumps, LeavesOutHighlightsOfTheStation) {
  const auto shine = [](Image<float>& image, double u0, double v0) {
    for (int v = 0; v < image.height(); ++v) {
      for (int u = 0; u < image.width(); ++u) {
        image(u, v) += static_cast<float>(0.4 * std::exp(-0.5 * (std::pow(u - u0, 2) + std::pow(v - v0, 2)) / 25));
      }
    }
  };
  const SweepResult dull = sweep_surface(bumpy().input, bumpy().views, test_options(), {});
  EXPECT_EQ(dull.highlights, 0);
  Scene shining = bumpy();
  shine(shining.input.intensity, 100, 40);
  shine(shining.views[2].intensity, 60, 90);  // the other photos outvote a highlight in one photo
  const SweepResult result = sweep_surface(shining.input, shining.views, test_options(), {});
  const double area = 3.14159265 * 16 * 16 / static_cast<double>(station_size.area());
  EXPECT_GT(result.highlights, 0.3 * area);
  EXPECT_LT(result.highlights, 1.5 * area);
  for (int v = 34; v <= 46; ++v) {
    for (int u = 94; u <= 106; ++u) EXPECT_TRUE(std::isnan(result.depth(u, v))) << u << ' ' << v;
  }
  EXPECT_LT(errors_of(result, bumpy().truth).rms_gsd, 0.3);

  // Photos of the object's back have no say.
  std::mt19937 random(5);
  std::uniform_real_distribution<float> shade(0.1F, 0.9F);
  for (int k = 0; k < 20; ++k) {
    SweepView back{Image<float>(distorted_lens().size), distorted_lens(), looking_from({40.0 * k - 400, 90, 850})};
    for (int v = 0; v < back.intensity.height(); v += 10) {
      for (int u = 0; u < back.intensity.width(); u += 10) {
        const float value = shade(random);
        for (int i = 0; i < 100; ++i) back.intensity(u + i % 10, v + i / 10) = value;
      }
    }
    shining.views.push_back(std::move(back));
  }
  EXPECT_EQ(sweep_surface(shining.input, shining.views, test_options(), {}).highlights, result.highlights);
}

TEST(SweepOfBumps, OneOrTwoPhotosGiveAWarningAndALargerSigma) {
  const SweepResult many = sweep_surface(bumpy().input, bumpy().views, test_options(), {});
  for (const int photos : {1, 2}) {
    std::string warnings;
    Context context;
    context.on_log = [&](LogLevel level, const std::string& text) {
      if (level == LogLevel::warning) warnings += text;
    };
    const SweepResult few =
        sweep_surface(bumpy().input, {bumpy().views.begin(), bumpy().views.begin() + photos}, test_options(), context);
    expect_contains(warnings, "too few photos to compare two groups of them");
    EXPECT_FALSE(few.halves_compared);
    EXPECT_GT(few.median_sigma_gsd, 2 * many.median_sigma_gsd);
    const Errors errors = errors_of(few, bumpy().truth);
    EXPECT_GT(errors.completeness, 0.9);
    EXPECT_LT(errors.median_gsd, 0.4);
  }
}

TEST(SweepOfBumps, PhotosThatAreThereTwiceDoNotConfirmEachOther) {
  std::vector<SweepView> views{bumpy().views.begin(), bumpy().views.begin() + 2};
  views.insert(views.end(), bumpy().views.begin(), bumpy().views.begin() + 2);
  EXPECT_FALSE(sweep_surface(bumpy().input, views, test_options(), {}).halves_compared);
}

TEST(SweepOfBumps, IsTheSameWithMoreThreads) {
  const Context three{.threads = 3};
  const SweepResult a = sweep_surface(bumpy().input, bumpy().views, test_options(), {});
  const SweepResult b = sweep_surface(bumpy().input, bumpy().views, test_options(), three);
  for (std::size_t i = 0; i < a.depth.count(); ++i) {
    ASSERT_EQ(std::isfinite(a.depth[i]), std::isfinite(b.depth[i]));
    if (!std::isfinite(a.depth[i])) continue;
    ASSERT_EQ(a.depth[i], b.depth[i]);
    ASSERT_EQ(a.sigma[i], b.sigma[i]);
  }
}

TEST(SweepOfBumps, IsNaNOutsideTheMaskAndAccurateUpToItsBorder) {
  SweepInput input = bumpy().input;
  for (int v = 0; v < station_size.height; ++v) {
    for (int u = 0; u < station_size.width; ++u) input.mask(u, v) = std::hypot(u - 80, v - 60) < 40;
  }
  const SweepResult result = sweep_surface(input, bumpy().views, test_options(), {});
  double squares = 0, pixels = 0;
  for (int v = 0; v < station_size.height; ++v) {
    for (int u = 0; u < station_size.width; ++u) {
      if (input.mask(u, v) == 0) {
        ASSERT_TRUE(std::isnan(result.depth(u, v)));
      } else if (std::isfinite(result.depth(u, v))) {
        squares += std::pow((result.depth(u, v) - bumpy().truth(u, v)) / gsd_mm, 2);
        ++pixels;
      }
    }
  }
  EXPECT_GT(pixels, 0.98 * 40 * 40 * 3.14);
  EXPECT_LT(std::sqrt(squares / pixels), 0.6);
}

TEST(SweepOfBumps, PhotosOfTwiceTheResolutionMatchToo) {
  LensCamera fine = distorted_lens();
  fine.size = {380, 280};
  for (const std::size_t k : {0U, 1U, 2U, 3U}) fine.params[k] *= 2;
  std::vector<SweepView> views;
  for (const std::size_t k : {0U, 2U, 4U}) views.push_back(photo(bumps, bumpy().views[k].pose.center(), fine));
  const Errors errors = errors_of(sweep_surface(bumpy().input, views, test_options(), {}), bumpy().truth);
  EXPECT_GT(errors.completeness, 0.95);
  EXPECT_LT(errors.median_gsd, 0.2);
}

TEST(SweepOfBumps, PhotosThatDoNotMatchGiveHardlyAnyDepth) {
  std::vector<SweepView> views = bumpy().views;
  unsigned state = 1;
  for (SweepView& view : views) {
    for (float& value : view.intensity) {
      state = state * 1664525U + 1013904223U;
      value = static_cast<float>(state >> 8) / 16777216.0F;
    }
  }
  const SweepResult result = sweep_surface(bumpy().input, views, test_options(), {});
  EXPECT_LT(result.completeness, 0.1);
}

TEST(SweepOfBumps, RefusesMissingAndMismatchedInput) {
  const auto sweep = [](const SweepInput& input, const std::vector<SweepView>& views) {
    return [&] { sweep_surface(input, views, test_options(), {}); };
  };
  const std::vector<SweepView> nothing;
  expect_error(ErrorCode::data, sweep(bumpy().input, nothing), "no photos");

  std::vector<SweepView> elsewhere = bumpy().views;
  const Eigen::DiagonalMatrix<double, 3> about_face(-1, 1, -1);
  for (SweepView& view : elsewhere) view.pose = {about_face * view.pose.rotation, about_face * view.pose.translation};
  expect_error(ErrorCode::data, sweep(bumpy().input, elsewhere), "none of 6 photos sees the object");

  SweepInput input = bumpy().input;
  input.points.resize(4);
  expect_error(ErrorCode::data, sweep(input, bumpy().views), "4 of 4 triangulated points");

  input = bumpy().input;
  input.points.front().x() = std::numeric_limits<double>::quiet_NaN();
  expect_error(ErrorCode::input, sweep(input, bumpy().views), "points: coordinates must be finite");

  input = bumpy().input;
  input.mask = Mask({10, 10}, 1, 255);
  expect_error(ErrorCode::input, sweep(input, bumpy().views), "mask is 10 x 10 pixels, expected 160 x 120");
  input.mask = Mask(station_size);
  expect_error(ErrorCode::input, sweep(input, bumpy().views), "mask: no pixel is set");

  std::vector<SweepView> views = bumpy().views;
  views[2].intensity(3, 3) = std::numeric_limits<float>::infinity();
  expect_error(ErrorCode::input, sweep(bumpy().input, views), "sweep: views[2]: intensities must be finite");
  views[2].intensity = Image<float>({5, 5});
  expect_error(ErrorCode::input, sweep(bumpy().input, views), "sweep: views[2] is 5 x 5 pixels, expected 190 x 140");

  SweepOptions options = test_options();
  options.window_radius = 9;
  expect_error(
      ErrorCode::input, [&] { sweep_surface(bumpy().input, bumpy().views, options, {}); }, "sweep.window_radius = 9");
}

TEST(SweepOfBumps, StopsWhenCanceled) {
  const std::atomic<bool> cancel{true};
  Context context;
  context.cancel = &cancel;
  expect_error(ErrorCode::interrupted, [&] { sweep_surface(bumpy().input, bumpy().views, test_options(), context); });
}

}  // namespace
}  // namespace malus
