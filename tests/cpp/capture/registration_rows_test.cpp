#include <gtest/gtest.h>

#include "capture/scenes.h"
#include "malus/capture/registration_rows_internal.h"

namespace malus {
namespace {

constexpr Size rows_size{160, 90};
constexpr int length = BlockRow::length;

/// Cubic convolution with a = −0.5 at a position, weights by distance.
double keys_value(const Image<float>& image, const Eigen::Vector2d& at) {
  const auto weight = [](double distance) {
    const double x = std::abs(distance);
    return x < 1 ? (1.5 * x - 2.5) * x * x + 1 : x < 2 ? ((-0.5 * x + 2.5) * x - 4) * x + 2 : 0;
  };
  const int u0 = static_cast<int>(std::floor(at.x())), v0 = static_cast<int>(std::floor(at.y()));
  double sum = 0;
  for (int v = v0 - 1; v < v0 + 3; ++v) {
    for (int u = u0 - 1; u < u0 + 3; ++u) sum += weight(at.x() - u) * weight(at.y() - v) * image(u, v);
  }
  return sum;
}

TEST(RegistrationRows, are_resampled_by_cubic_convolution) {
  const Image<float> scene = AnalyticScene{}.image(rows_size, identity_affine(), 0);
  // Rotation and scale large enough that a row crosses samples of the source in both directions.
  for (const double turn : {0.0, 0.03, -0.02}) {
    for (const double scale : {1.0, 1.02, 0.97}) {
      const Affine map = similarity(rows_size, turn, scale, 1.3, -0.6);
      std::vector<float> row(100);
      for (const int v : {20, 45, 70}) {
        resample_row(scene, map, 30, v, row);
        for (int i = 0; i < 100; ++i) {
          const Eigen::Vector2d at = map * Eigen::Vector3d(30 + i, v, 1);
          EXPECT_NEAR(row[static_cast<std::size_t>(i)], keys_value(scene, at), 2e-6);
        }
      }
    }
  }
}

/// Three rows in three images, and their mean.
struct Rows {
  float bands[3][3][length], mean[3][length], information[length];

  Rows() {
    for (int v = 0; v < 3; ++v) {
      for (int i = 0; i < length; ++i) {
        for (int k = 0; k < 3; ++k) {
          bands[v][k][i] =
              static_cast<float>(0.1 * std::sin(0.3 * i + 0.4 * v + 0.2 * k) + 0.01 * std::cos(1.7 * i * k));
        }
      }
      const float* const images[] = {bands[v][0], bands[v][1], bands[v][2]};
      mean_row(images, mean[v]);
    }
    for (int i = 0; i < length; ++i) information[i] = i == 0 || i > length - 5 ? 0 : 100 + static_cast<float>(i);
  }
};

TEST(RegistrationRows, sums_are_those_of_the_normal_equations) {
  const Rows rows;
  const float* const images[] = {rows.bands[1][0], rows.bands[1][1], rows.bands[1][2]};
  const float cauchy = 0.3f;
  const AlignedRow row{images, rows.mean[1], rows.mean[0], rows.mean[2], rows.information, -0.4f, 0.002f};
  float weights[length], disagreement[length];
  RowSums sums;
  sums.sides.resize(3);
  sum_row(row, cauchy, sums, weights);
  disagreements(row, disagreement);

  RowSums expected;
  expected.sides.resize(3);
  for (int i = 1; i < length - 1; ++i) {
    double mean = 0, squares = 0;
    for (const float* const image : images) mean += image[i] / 3.0;
    for (const float* const image : images) squares += (image[i] - mean) * (image[i] - mean);
    EXPECT_NEAR(disagreement[i], rows.information[i] * squares / 2, 1e-5 * (1 + disagreement[i]));
    const double weight = rows.information[i] / (1 + rows.information[i] * squares / 2 / cauchy);
    EXPECT_NEAR(weights[i], weight, 1e-4 * weight + 1e-6);
    const double x = -0.4 + 0.002 * i, gu = 0.5 * (rows.mean[1][i + 1] - rows.mean[1][i - 1]),
                 gv = 0.5 * (rows.mean[2][i] - rows.mean[0][i]);
    const double products[] = {gu * gu, gu * gv, gv * gv};
    for (int j = 0; j < 3; ++j) {
      for (int m = 0; m < 3; ++m) expected.gradients[j][m] += weight * products[j] * std::pow(x, m);
    }
    for (std::size_t k = 0; k < 3; ++k) {
      const double rest = weight * (mean - images[k][i]);
      for (int m = 0; m < 2; ++m) {
        expected.sides[k].along_u[m] += rest * gu * std::pow(x, m);
        expected.sides[k].along_v[m] += rest * gv * std::pow(x, m);
      }
    }
  }
  for (int j = 0; j < 3; ++j) {
    for (int m = 0; m < 3; ++m) {
      EXPECT_NEAR(sums.gradients[j][m], expected.gradients[j][m], 1e-4 * std::abs(expected.gradients[j][m]) + 1e-5);
    }
  }
  for (std::size_t k = 0; k < 3; ++k) {
    for (int m = 0; m < 2; ++m) {
      EXPECT_NEAR(sums.sides[k].along_u[m], expected.sides[k].along_u[m], 1e-4);
      EXPECT_NEAR(sums.sides[k].along_v[m], expected.sides[k].along_v[m], 1e-4);
    }
  }
}

}  // namespace
}  // namespace malus
