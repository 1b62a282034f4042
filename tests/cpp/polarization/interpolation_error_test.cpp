#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "malus/core/error.h"
#include "malus/polarization/interpolation_error_internal.h"

namespace malus {
namespace {

/// Uniform polarized light seen through four polarizers; the residual is given in standard deviations.
PolarizationState uniform_state(float residual) {
  const Size size{40, 30};
  PolarizationState state;
  state.i_un = Image<float>(size, 1, 0.3f);
  state.rho = Image<float>(size, 1, 0.1f);
  state.phi = Image<float>(size, 1, 0.5f);
  state.residual = Image<float>(size, 1, residual);
  state.valid = Mask(size, 1, 255);
  for (const int angle : {90, 45, 135, 0}) state.angles_rad.push_back(angle * std::numbers::pi / 180);
  state.exposures.assign(4, 1);
  return state;
}

TEST(InterpolationError, VarianceFactorIsFiveTimesSquaredResidualTimesSharingPixels) {
  PolarizationState state = uniform_state(3);
  const Eigen::Matrix3d noise = state.stokes_covariance(20, 15);
  add_interpolation_error(state, Image<float>(state.size(), 1, 10.0f), {});
  EXPECT_NEAR(state.stokes_covariance(20, 15)(1, 1), 5 * 10 * 9 * noise(1, 1), 1e-3 * noise(1, 1));
  EXPECT_NEAR(state.covariance(0, 0)(2, 2) / state.covariance(20, 15)(2, 2), 1, 1e-4);
}

TEST(InterpolationError, VarianceFactorIsAtLeastFour) {
  PolarizationState state = uniform_state(0.1f);
  const double noise = state.stokes_covariance(5, 5)(2, 2);
  add_interpolation_error(state, Image<float>(state.size(), 1, 10.0f), {});
  EXPECT_NEAR(state.stokes_covariance(5, 5)(2, 2), 4 * noise, 1e-6 * noise);
  const StokesVariance quick = StokesVariances(state)(5, 5, state.stokes(5, 5));
  EXPECT_NEAR(quick.intensity, state.stokes_covariance(5, 5)(0, 0), 1e-6 * noise);
}

TEST(InterpolationError, IsLocalAndDoesNotDependOnThreads) {
  PolarizationState state = uniform_state(1), other = uniform_state(1);
  for (PolarizationState* each : {&state, &other}) {
    for (int v = 0; v < 30; ++v) {
      for (int u = 0; u < 8; ++u) each->residual(u, v) = 8;
      each->residual(25, v) = std::nanf("");
    }
  }
  const Image<float> shared(state.size(), 1, 4.0f);
  const Context threads{.threads = 3};
  add_interpolation_error(state, shared, {});
  add_interpolation_error(other, shared, threads);
  EXPECT_GT(state.variance_factor(2, 15), 200);
  EXPECT_NEAR(state.variance_factor(35, 15), 20, 1e-4);
  for (std::size_t i = 0; i < state.variance_factor.count(); ++i) {
    ASSERT_EQ(state.variance_factor[i], other.variance_factor[i]);
  }
  EXPECT_THROW(add_interpolation_error(state, Image<float>({3, 3}), {}), Error);
}

}  // namespace
}  // namespace malus
