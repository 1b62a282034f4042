#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>

#include "malus/core/square_internal.h"
#include "malus/fusion/refinement_image_internal.h"
#include "malus/fusion/refinement_weights_internal.h"
#include "malus/fusion/surface_sigma_internal.h"
#include "synthetic_station.h"

namespace malus {
namespace {

constexpr Size sigma_size{160, 128};
constexpr double prior_sigma_gsd = 0.5;  // of the synthetic station
constexpr std::uint8_t nothing = 0, all = 255;

/// Height in GSD as a function of the distances x and y from the image's center in px.
using Shape = std::function<double(double, double)>;

/// A spherical cap of this curvature [1 / px], seen from above.
Shape cap(double curvature) {
  return [=](double x, double y) { return 0.5 * curvature * (x * x + y * y); };
}

/// Waves along x with this largest curvature.
constexpr double wave_px = 16, wave_frequency = 2 * std::numbers::pi / wave_px;
Shape waves(double curvature) {
  return [=](double x, double) { return curvature / square(wave_frequency) * std::sin(wave_frequency * x); };
}

/// The sigma that these waves get in the image's middle for what smoothing over a length and over windows cuts off.
double cut_off(double curvature, double length_px, double windows_px) {
  // A node is the mean of the pixels left and right of it, and its curvature a second difference.
  const double found =
      curvature / square(wave_frequency) * std::cos(wave_frequency / 2) * 2 * (1 - std::cos(wave_frequency));
  const auto kept = [](double gaussian_px, double frequency) {
    return std::exp(-0.5 * square(gaussian_px * frequency));
  };
  const double change = found * (1 - kept(2 * length_px, wave_frequency));
  const double mean_square = 0.5 * square(change) * (1 - kept(length_px, 2 * wave_frequency));
  return 0.6 * (square(length_px) + square(windows_px)) * std::sqrt(mean_square);
}

/// Sigma in GSD of a surface that equals its prior and whose polarization is the reflection model's prediction.
Image<float> sigma_of(const Shape& shape, const PriorErrors& errors, std::uint8_t trust, int first_column = 0) {
  SyntheticOptions scene;
  scene.size = sigma_size;
  SyntheticStation station = make_station(scene);
  const double gsd = station_gsd_mm;
  for (int v = 0; v < sigma_size.height; ++v) {
    for (int u = 0; u < sigma_size.width; ++u) {
      const double x = u - 0.5 * sigma_size.width, y = v - 0.5 * sigma_size.height;
      station.prior.depth(u, v) = static_cast<float>(500 + gsd * shape(x, y));
      if (u < first_column) station.state.valid(u, v) = static_cast<std::uint8_t>(PixelState::outside);
    }
  }
  RefinementImage image = make_image(station.state, station.prior, Context{});
  image.kind.fill(Reflection::diffuse);
  RefinementField field = image.part(image.everything(), Context{});
  for (int v = 0; v < sigma_size.height; ++v) {
    for (int u = first_column; u < sigma_size.width; ++u) {
      const Slopes slopes = central_slopes(field, u, v);
      const PredictedStokes model = field.reflection_at(u, v).predict(slopes.p, slopes.q);
      field.s1(u, v) = static_cast<float>(model.s1);
      field.s2(u, v) = static_cast<float>(model.s2);
    }
  }
  update_weights(field, {}, Context{});
  Image<float> sigma = surface_sigma(field, Image<std::uint8_t>(field.size(), 1, trust), errors, Context{});
  for (std::size_t i = 0; i < sigma.count(); ++i) {
    if (field.object[i]) sigma[i] /= static_cast<float>(field.depth_of(field.x[i]) / field.camera.focal());
  }
  return sigma;
}

TEST(SurfaceSigma, EqualsThePriorsSigmaWithoutSmoothing) {
  EXPECT_NEAR(sigma_of(waves(0.01), {0}, nothing)(80, 64), prior_sigma_gsd, 0.01);
}

TEST(SurfaceSigma, IncludesTheReliefThatSmoothingAndWindowsOf2PxCutOff) {
  const double plane = sigma_of(cap(0), {5}, nothing)(80, 64);
  EXPECT_NEAR(plane, 0.3 * prior_sigma_gsd, 0.02);
  for (const double length : {3, 5, 10}) {
    const double cut = cut_off(0.1, length, 2);
    EXPECT_NEAR(sigma_of(waves(0.1), {length}, nothing)(80, 64), std::hypot(plane, cut), 0.03 * cut) << length;
  }
  EXPECT_NEAR(sigma_of(cap(0.02), {5}, nothing)(80, 64), plane, 0.1 * cut_off(0.02, 5, 2))
      << "smoothing cuts off nothing of a ball";
}

TEST(SurfaceSigma, ReliefOnASlopeIsCutOffAsMuchAlongTheRayAsReliefThatFacesTheCamera) {
  // Across the waves: the slope along them is the same everywhere.
  const Shape inclined = [](double x, double y) { return waves(0.02)(x, y) + 1.5 * y; };
  const double facing = sigma_of(waves(0.02), {8}, nothing)(80, 64);
  EXPECT_NEAR(sigma_of(inclined, {8}, nothing)(80, 64), facing, 0.05 * facing);
}

TEST(SurfaceSigma, IsNotReducedForPointsThatShareTheirWindows) {
  const PriorErrors swept{.smoothing_px = 5, .shares_windows = true};
  EXPECT_NEAR(sigma_of(cap(0), swept, nothing)(80, 64), prior_sigma_gsd, 0.02);
  const double cut = cut_off(0.1, 5, 0);  // their sigma contains what the windows cut off
  EXPECT_NEAR(sigma_of(waves(0.1), swept, nothing)(80, 64), std::hypot(prior_sigma_gsd, cut), 0.03 * cut);
}

TEST(SurfaceSigma, IsSmallerWhereTheSurfaceIsRefined) {
  // Polarization determines slopes only where the surface is inclined.
  const Shape wavy_cap = [](double x, double y) { return cap(0.02)(x, y) + waves(0.04)(x, y); };
  EXPECT_LT(sigma_of(wavy_cap, {5}, all)(100, 64), 0.8 * sigma_of(wavy_cap, {5}, nothing)(100, 64));
}

TEST(SurfaceSigma, GrowsAtTheContourButNotAtTheBorderOfTheImage) {
  constexpr int contour = 40;
  for (const std::uint8_t trust : {nothing, all}) {
    const Image<float> sigma = sigma_of(cap(0), {5}, trust, contour);
    EXPECT_GT(sigma(contour + 1, 64), 2);
    EXPECT_LT(sigma(contour + 8, 64), 1);
    EXPECT_LT(sigma(sigma_size.width - 2, 64), 1);
    EXPECT_TRUE(std::isnan(sigma(contour - 2, 64)));
  }
}

TEST(SurfaceSigma, IsAsLargeAtTheBordersOfTheImageAsBesideThem) {
  // So steep that the polarization determines the slopes everywhere.
  const Shape plane = [](double x, double y) { return x + y; };
  const Image<float> sigma = sigma_of(plane, {}, all);
  constexpr int beside = 12;  // beyond the reach of a pixel's slopes
  const int right = sigma_size.width - 1, bottom = sigma_size.height - 1;
  EXPECT_NEAR(sigma(0, 64) / sigma(beside, 64), 1, 0.1);
  EXPECT_NEAR(sigma(right, 64) / sigma(right - beside, 64), 1, 0.1);
  EXPECT_NEAR(sigma(80, 0) / sigma(80, beside), 1, 0.1);
  EXPECT_NEAR(sigma(80, bottom) / sigma(80, bottom - beside), 1, 0.1);
}

}  // namespace
}  // namespace malus
