#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "malus/stereo/match_rows_internal.h"

namespace malus {
namespace {

std::vector<float> random_values(std::size_t count, unsigned seed, float least = 0) {
  std::mt19937 generator(seed);
  std::uniform_real_distribution<float> uniform(least, 1);
  std::vector<float> values(count);
  for (float& value : values) value = uniform(generator);
  return values;
}

TEST(MatchRows, SamplesAlongParabolasAndHoldsTheBorder) {
  // An image that is linear in x and y is interpolated without error.
  Image<float> image({50, 40});
  for (int v = 0; v < 40; ++v) {
    for (int u = 0; u < 50; ++u) image(u, v) = 2.0F * static_cast<float>(u) - 3.0F * static_cast<float>(v);
  }
  const std::size_t count = 131;
  std::vector<std::vector<float>> path{random_values(count, 1), random_values(count, 2), random_values(count, 3),
                                       random_values(count, 4), random_values(count, 5), random_values(count, 6)};
  for (std::size_t i = 0; i < count; ++i) path[0][i] = 0.3F * static_cast<float>(i) + 5;
  const float t = -0.7F;
  std::vector<float> out(count);
  sample_row(PhotoCells(image, Context()),
             {path[0].data(), path[1].data(), path[2].data(), path[3].data(), path[4].data(), path[5].data()}, t, count,
             out.data());
  for (std::size_t i = 0; i < count; ++i) {
    const float x = path[0][i] + t * path[1][i] + t * t * path[2][i];
    const float y = path[3][i] + t * path[4][i] + t * t * path[5][i];
    EXPECT_NEAR(out[i], 2 * std::min(x, 49.0F) - 3 * std::max(y, 0.0F), 4e-3) << i;
  }
}

TEST(MatchRows, WindowLinesAreSumsOverNeighbors) {
  for (const std::size_t window : {3U, 7U, 9U, 11U, 15U, 17U}) {
    const std::size_t width = 37, count = width + window - 1;
    const std::vector<float> a = random_values(count, 1), b = random_values(count, 2);
    std::vector<float> weight(count, 1.0F), scratch(count), lines(3 * width);
    weight[5] = weight[20] = 0;
    window_lines(a.data(), weight.data(), b.data(), width, window, scratch.data(), lines.data());
    for (std::size_t i = 0; i < width; ++i) {
      double sum = 0, squares = 0, products = 0;
      for (std::size_t k = i; k < i + window; ++k) {
        sum += weight[k] * a[k];
        squares += weight[k] * a[k] * a[k];
        products += a[k] * b[k];
      }
      EXPECT_NEAR(lines[i], sum, 1e-5) << window << " at " << i;
      EXPECT_NEAR(lines[width + i], squares, 1e-5) << window << " at " << i;
      EXPECT_NEAR(lines[2 * width + i], products, 1e-5) << window << " at " << i;
    }
  }
}

TEST(MatchRows, CorrelationDoesNotDependOnGainAndOffset) {
  const std::size_t window = 7, width = 20, stride = width + window - 1;
  for (const float gain : {0.5F, 2.0F, -1.0F}) {
    std::vector<float> lines, mean(width, 0.0F), deviation(width, 0.0F), weight(stride, 1.0F), scratch(stride);
    for (unsigned v = 0; v < window; ++v) {
      const std::vector<float> reference = random_values(stride, v);
      std::vector<float> photo = reference, line(3 * width);
      for (float& value : photo) value = gain * value + 0.1F;
      window_lines(photo.data(), weight.data(), reference.data(), width, window, scratch.data(), line.data());
      lines.insert(lines.end(), line.begin(), line.end());
      for (std::size_t i = 0; i < width; ++i) {
        for (std::size_t k = i; k < i + window; ++k) {
          mean[i] += reference[k] / 49;
          deviation[i] += reference[k] * reference[k] / 49;
        }
      }
    }
    for (std::size_t i = 0; i < width; ++i) deviation[i] = 1 / std::sqrt(deviation[i] - mean[i] * mean[i]);
    const std::vector<float> inverse_count(width, 1 / 49.0F);
    std::vector<float> seen(width, 1.0F), totals(3 * width), out(width);
    seen[3] = 0;
    correlate_row(lines.data(), window, width, {inverse_count.data(), mean.data(), deviation.data()}, seen.data(),
                  1e-9F, totals.data(), out.data());
    for (std::size_t i = 0; i < width; ++i) EXPECT_NEAR(out[i], i != 3 && gain > 0 ? 1 : 0, 1e-4) << gain;
  }
}

TEST(MatchRows, AveragesTheBestViewsOrAllIfThereAreFewer) {
  const std::size_t width = 2;
  std::vector<float> best(2 * width, 0.0F);
  const std::vector<std::vector<float>> views{{0.2F, 0.9F}, {0.8F, 0.0F}, {0.6F, 0.0F}};
  for (std::vector<float> values : views) insert_row(values.data(), width, 2, best.data());
  const std::vector<float> seen{3, 1};
  std::vector<float> out(width);
  mean_row(best.data(), width, 2, seen.data(), out.data());
  EXPECT_FLOAT_EQ(out[0], 0.7F);
  EXPECT_FLOAT_EQ(out[1], 0.9F);
}

}  // namespace
}  // namespace malus
