#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>

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
constexpr double wave_px = 16;
Shape waves(double curvature) {
  const double frequency = 2 * std::numbers::pi / wave_px;
  return [=](double x, double) { return curvature / (frequency * frequency) * std::sin(frequency * x); };
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

TEST(SurfaceSigma, IncludesTheReliefThatSmoothingCutsOff) {
  const double plane = sigma_of(cap(0), {5}, nothing)(80, 64);
  EXPECT_NEAR(plane, 0.3 * prior_sigma_gsd, 0.02);
  // Smoothing over the length L cuts off 0.6 L² times the RMS curvature; the points' windows smooth over 2 px.
  const auto cut = [](double length2) { return 0.6 * (length2 + 4) * 0.02 / std::sqrt(2.0); };
  EXPECT_NEAR(sigma_of(waves(0.02), {5}, nothing)(80, 64), std::hypot(plane, cut(25)), 0.1 * cut(25));
  EXPECT_NEAR(sigma_of(waves(0.02), {10}, nothing)(80, 64), std::hypot(plane, cut(100)), 0.1 * cut(100));
  EXPECT_NEAR(sigma_of(cap(0.02), {5}, nothing)(80, 64), plane, 0.1 * cut(25))
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

}  // namespace
}  // namespace malus
