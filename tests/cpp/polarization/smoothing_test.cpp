#include <gtest/gtest.h>
#include <sys/resource.h>

#include <cmath>
#include <numbers>
#include <random>

#include "malus/polarization/decompose_internal.h"
#include "malus/polarization/smoothing_internal.h"

namespace malus {
namespace {

constexpr Size smoothed_size{90, 70};
/// Where the degree of polarization of the scene jumps.
constexpr int edge_column = 45;

Context two_threads_of_smoothing() {
  return {.threads = 2};
}

double true_degree(int u) {
  return u < edge_column ? 0.05 : 0.35;
}

/// Six images, each with errors of its own of `errors` standard deviations of the noise, as noise and resampled texture
/// have them.
PolarizationState state_with_errors(double errors, Size size = smoothed_size) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  const NoiseModel noise{20000, 8, 0, 1};
  std::vector<Image<float>> images;
  std::vector<double> angles;
  for (int k = 0; k < 6; ++k) {
    angles.push_back(k * std::numbers::pi / 6);
    images.emplace_back(size);
    for_each_pixel(size, [&](int u, int v) {
      const double intensity = 0.3 * (1 + true_degree(u) * std::cos(2 * (angles.back() - 0.4)));
      images.back()(u, v) =
          static_cast<float>(intensity + errors * std::sqrt(noise.variance(intensity)) * normal(random));
    });
  }
  return decompose(images, angles, noise, Mask(size, 1, 255), Mask(size), {}, Context{});
}

/// RMS error of (s1, s2) / s0 in these columns.
double rms_error(const PolarizationState& state, int first, int last) {
  double squares = 0;
  int count = 0;
  for (int v = 8; v < smoothed_size.height - 8; ++v) {
    for (int u = first; u < last; ++u, ++count) {
      const double rho = state.rho(u, v), turn = 2 * (state.phi(u, v) - 0.4), degree = true_degree(u);
      squares += std::pow(rho * std::cos(turn) - degree, 2) + std::pow(rho * std::sin(turn), 2);
    }
  }
  return std::sqrt(squares / count);
}

TEST(Smoothing, errors_that_the_residuals_show_are_averaged_away) {
  PolarizationState state = state_with_errors(4);
  const double before = rms_error(state, 8, edge_column - 12);
  smooth_polarization(state, {});
  EXPECT_LT(rms_error(state, 8, edge_column - 12), 0.55 * before);
}

TEST(Smoothing, noise_is_left_to_fusion) {
  PolarizationState state = state_with_errors(1);
  const double before = rms_error(state, 8, edge_column - 12);
  smooth_polarization(state, {});
  EXPECT_GT(rms_error(state, 8, edge_column - 12), 0.85 * before);
}

TEST(Smoothing, edges_above_the_errors_stay) {
  PolarizationState state = state_with_errors(4);
  smooth_polarization(state, {});
  EXPECT_LT(rms_error(state, edge_column - 1, edge_column + 1), 0.055) << "the mean over the neighbors is off by 0.08";
}

TEST(Smoothing, changes_nothing_but_the_polarization_of_valid_pixels) {
  PolarizationState state = state_with_errors(2);
  state.valid(30, 30) = static_cast<std::uint8_t>(PixelState::saturated);
  state.rho(30, 30) = 0.9f;
  const PolarizationState before = state;
  smooth_polarization(state, {});
  EXPECT_EQ(state.i_un, before.i_un);
  EXPECT_EQ(state.residual, before.residual);
  EXPECT_EQ(state.rho(30, 30), 0.9f);
  EXPECT_LT(state.rho(31, 30), 0.1f) << "a saturated neighbor does not count";
  EXPECT_NE(state.rho(10, 30), before.rho(10, 30));
}

TEST(Smoothing, threads_do_not_change_a_bit) {
  PolarizationState one = state_with_errors(2), many = one;
  smooth_polarization(one, {});
  smooth_polarization(many, two_threads_of_smoothing());
  EXPECT_EQ(one.rho, many.rho);
  EXPECT_EQ(one.phi, many.phi);
}

/// Some rows of a state, as an image of their own.
PolarizationState rows_of(const PolarizationState& state, int begin, int end) {
  PolarizationState part = state;
  const Size size{state.size().width, end - begin};
  const auto cut = [&](const auto& from, auto& to) {
    to = std::decay_t<decltype(from)>(size);
    std::copy(from.row(begin), from.row(begin) + size.area(), to.begin());
  };
  cut(state.i_un, part.i_un);
  cut(state.rho, part.rho);
  cut(state.phi, part.phi);
  cut(state.residual, part.residual);
  cut(state.valid, part.valid);
  return part;
}

TEST(Smoothing, the_strips_of_a_large_image_have_no_seams) {
  PolarizationState whole = state_with_errors(2, {20, 800});
  for (const int end : {256, 512}) {
    PolarizationState part = rows_of(whole, end - 100, end + 100);
    smooth_polarization(part, {});
    PolarizationState all = whole;
    smooth_polarization(all, {});
    for (int v = 20; v < 180; ++v) {
      EXPECT_EQ(part.rho(10, v), all.rho(10, v + end - 100)) << v;
      EXPECT_EQ(part.phi(10, v), all.phi(10, v + end - 100)) << v;
    }
  }
}

#ifndef __SANITIZE_ADDRESS__
long most_kilobytes() {
  rusage use{};
  getrusage(RUSAGE_SELF, &use);
  return use.ru_maxrss;
}

TEST(Smoothing, a_large_image_needs_little_memory_beside_it) {
  const Size size{200, 6000};
  PolarizationState state = rows_of(state_with_errors(2, {200, 50}), 0, 50);
  for (Image<float>* raster : {&state.i_un, &state.rho, &state.phi, &state.residual})
    *raster = Image<float>(size, 1, 0.5F);
  state.valid = Mask(size, 1, 255);
  const long before = most_kilobytes();
  smooth_polarization(state, {});
  EXPECT_LT(most_kilobytes() - before, 10 * static_cast<long>(size.area()) / 1024) << "it has 17 bytes a pixel itself";
}
#endif

TEST(Smoothing, three_images_leave_no_residual_to_judge_by) {
  PolarizationState state = state_with_errors(1);
  state.residual.fill(0);
  const Image<float> before = state.rho;
  smooth_polarization(state, {});
  for (std::size_t i = 0; i < before.count(); ++i) EXPECT_NEAR(state.rho[i], before[i], 1e-6);
}

}  // namespace
}  // namespace malus
