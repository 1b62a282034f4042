#include <gtest/gtest.h>

#include <Eigen/LU>
#include <numbers>
#include <random>

#include "degree.h"
#include "malus/polarization/decompose_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

std::vector<double> even_angles(int count) {
  std::vector<double> angles;
  for (int k = 0; k < count; ++k) angles.push_back(k * std::numbers::pi / count);
  return angles;
}

/// Images of a field of known Stokes vectors, with the noise model's Gaussian noise if `seed` is not 0.
std::vector<Image<float>> images_of(const std::function<Eigen::Vector3d(int, int)>& stokes, Size size,
                                    const std::vector<double>& angles, const NoiseModel& noise, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::vector<Image<float>> images;
  for (const double a : angles) {
    Image<float> image(size);
    for (int v = 0; v < size.height; ++v) {
      for (int u = 0; u < size.width; ++u) {
        const Eigen::Vector3d s = stokes(u, v);
        const double value = 0.5 * (s[0] + s[1] * std::cos(2 * a) + s[2] * std::sin(2 * a));
        image(u, v) = static_cast<float>(value + (seed > 0 ? std::sqrt(noise.variance(value)) * normal(random) : 0.0));
      }
    }
    images.push_back(std::move(image));
  }
  return images;
}

Eigen::Vector3d stokes_vector(double i_un, double rho, double phi) {
  return 2 * i_un * Eigen::Vector3d(1, rho * std::cos(2 * phi), rho * std::sin(2 * phi));
}

Mask full(Size size) {
  return Mask(size, 1, 255);
}

TEST(Decompose, RecoversTheSinusoid) {
  const Size size{40, 30};
  const auto truth = [](int u, int v) { return stokes_vector(0.2 + 0.01 * u, 0.02 + 0.02 * v, (u * 30 + v) * 0.002); };
  for (const auto weighting : {FitWeighting::uniform, FitWeighting::noise}) {
    const auto angles = even_angles(6);
    DecomposeOptions options;
    options.weighting = weighting;
    const auto state = decompose(images_of(truth, size, angles, {}, 0), angles, {}, full(size), {}, options, {});
    for (int v = 0; v < size.height; ++v) {
      for (int u = 0; u < size.width; ++u) {
        const double phi = std::fmod((u * 30 + v) * 0.002, std::numbers::pi);
        EXPECT_NEAR(state.i_un(u, v), 0.2 + 0.01 * u, 1e-6);
        EXPECT_NEAR(state.rho(u, v), 0.02 + 0.02 * v, 1e-6);
        EXPECT_NEAR(std::remainder(state.phi(u, v) - phi, std::numbers::pi), 0, 1e-6 / (0.02 + 0.02 * v));
        EXPECT_LT(state.residual(u, v), 1e-3);
        EXPECT_TRUE(state.is_valid(u, v));
        EXPECT_TRUE((state.stokes(u, v) - truth(u, v)).norm() < 2e-6);
      }
    }
  }
}

TEST(Decompose, PhaseTurnsCounterClockwiseFromImageX) {
  // Light polarized along 30° is brightest through the filter at 30° and dark at 120°.
  const std::vector<double> angles{0, 30 * degree_rad, 60 * degree_rad, 120 * degree_rad};
  std::vector<Image<float>> images;
  for (const double a : angles)
    images.emplace_back(Size{1, 1}, 1, static_cast<float>(std::pow(std::cos(a - 30 * degree_rad), 2)));
  const auto state = decompose(images, angles, {}, full({1, 1}), {}, {}, {});
  EXPECT_NEAR(state.phi(0, 0), 30 * degree_rad, 1e-6);
  EXPECT_NEAR(state.rho(0, 0), 1, 1e-6);
}

TEST(Decompose, RepeatedAnglesAreSeveralExposures) {
  const Size size{8, 8};
  const auto truth = [](int, int) { return stokes_vector(0.4, 0.1, 1.0); };
  const std::vector<double> repeated{0, std::numbers::pi, 1, 2, 2 + std::numbers::pi};
  const auto images = images_of(truth, size, repeated, {}, 3);
  const auto state = decompose(images, repeated, {}, full(size), {}, {}, {});
  EXPECT_EQ(state.angles_rad.size(), 3u);
  EXPECT_EQ(state.exposures, (std::vector<int>{2, 1, 2}));

  std::vector<Image<float>> averaged{images[0], images[2], images[3]};
  for (std::size_t i = 0; i < averaged[0].count(); ++i) {
    averaged[0][i] = 0.5f * (images[0][i] + images[1][i]);
    averaged[2][i] = 0.5f * (images[3][i] + images[4][i]);
  }
  const std::vector<double> angles{0, 1, 2};
  const auto expected = decompose(averaged, angles, {}, full(size), {}, {}, {});
  for (std::size_t i = 0; i < state.rho.count(); ++i) EXPECT_NEAR(state.rho[i], expected.rho[i], 1e-6);
}

TEST(Decompose, TooFewOrDegenerateAnglesAreADataError) {
  const auto fit = [](const std::vector<double>& angles) {
    const std::vector<Image<float>> images(angles.size(), Image<float>({2, 2}, 1, 0.5f));
    decompose(images, angles, {}, full({2, 2}), {}, {}, {});
  };
  expect_error(ErrorCode::data, [&] { fit({0, 1}); });
  expect_error(ErrorCode::data, [&] { fit({0, 1, std::numbers::pi, 1 + std::numbers::pi}); });
  expect_error(ErrorCode::data, [&] { fit({0, 1 * degree_rad, 2 * degree_rad}); });
  expect_error(ErrorCode::data, [&] { fit({}); });
  EXPECT_NO_THROW(fit({0, 45 * degree_rad, 90 * degree_rad}));
  EXPECT_NEAR(angle_condition(even_angles(6)), 2, 1e-9);
  EXPECT_TRUE(std::isinf(angle_condition(even_angles(2))));
}

TEST(Decompose, InputErrorsNameWhatIsWrong) {
  const std::vector<double> angles = even_angles(3);
  const auto expect_input_error = [&](const std::vector<Image<float>>& images, const std::vector<double>& a,
                                      const Mask& mask, const Mask& saturated, const std::string& word) {
    expect_error(
        ErrorCode::input, [&] { decompose(images, a, {}, mask, saturated, {}, {}); }, word);
  };
  const std::vector<Image<float>> good(3, Image<float>({2, 2}, 1, 0.5f));
  expect_input_error({good[0], good[1], Image<float>({3, 2}, 1, 0.5f)}, angles, full({2, 2}), {}, "image 2");
  expect_input_error({good[0], good[1], Image<float>({2, 2}, 3, 0.5f)}, angles, full({2, 2}), {}, "channels");
  expect_input_error({good[0], good[1]}, angles, full({2, 2}), {}, "angles");
  expect_input_error(good, {0, 1, NAN}, full({2, 2}), {}, "angle");
  expect_input_error(good, angles, full({4, 2}), {}, "mask");
  expect_input_error(good, angles, full({2, 2}), full({4, 2}), "saturation");
}

TEST(Decompose, PixelStatesInOrderOfPrecedence) {
  const Size size{6, 1};
  const auto angles = even_angles(6);
  auto images = images_of([](int u, int) { return stokes_vector(u == 2 ? 0.0 : 0.5, 0.1, 1); }, size, angles, {}, 0);
  images[3](3, 0) = 0.9f;
  images[2](5, 0) = NAN;
  Mask mask = full(size), saturated(size);
  mask(0, 0) = 0;
  saturated(1, 0) = 255;
  const auto state = decompose(images, angles, {}, mask, saturated, {}, {});
  const PixelState expected[] = {PixelState::outside, PixelState::saturated, PixelState::dark,
                                 PixelState::misfit,  PixelState::valid,     PixelState::outside};
  const Mask valid = state.valid_pixels(), object = state.object();
  for (int u = 0; u < 6; ++u) {
    EXPECT_EQ(state.valid(u, 0), static_cast<std::uint8_t>(expected[u])) << u;
    EXPECT_EQ(valid(u, 0), expected[u] == PixelState::valid ? 255 : 0) << u;
    EXPECT_EQ(object(u, 0), expected[u] != PixelState::outside ? 255 : 0) << u;
  }
  EXPECT_TRUE(std::isnan(state.rho(0, 0)));
  EXPECT_TRUE(std::isfinite(state.rho(1, 0)));
  EXPECT_TRUE(std::isnan(state.rho(5, 0)));

  DecomposeOptions options;
  options.recover_outliers = true;
  const auto recovered = decompose(images, angles, {}, mask, saturated, options, {});
  EXPECT_TRUE(recovered.is_valid(3, 0));
  EXPECT_NEAR(recovered.rho(3, 0), 0.1, 1e-6);
}

TEST(Decompose, CovarianceAgreesWithMonteCarlo) {
  const Size size{200, 200};
  const std::vector<double> angles{0, 20 * degree_rad, 60 * degree_rad, 60 * degree_rad, 110 * degree_rad};
  NoiseModel noise;
  noise.full_well_e = 5000;
  const Eigen::Vector3d truth = stokes_vector(0.3, 0.5, 0.4);
  const auto images = images_of([&](int, int) { return truth; }, size, angles, noise, 7);
  for (const auto weighting : {FitWeighting::uniform, FitWeighting::noise}) {
    DecomposeOptions options;
    options.weighting = weighting;
    const auto state = decompose(images, angles, noise, full(size), {}, options, {});
    Eigen::Matrix3d stokes = Eigen::Matrix3d::Zero(), reduced = Eigen::Matrix3d::Zero();
    Eigen::Matrix3d expected_stokes = Eigen::Matrix3d::Zero(), expected_reduced = Eigen::Matrix3d::Zero();
    double residual = 0;
    const double count = static_cast<double>(size.area());
    const StokesVariances variances(state);
    for (int v = 0; v < size.height; ++v) {
      for (int u = 0; u < size.width; ++u) {
        const Eigen::Vector3d e = state.stokes(u, v) - truth;
        const Eigen::Vector3d r(state.i_un(u, v) - 0.3, state.rho(u, v) - 0.5, state.phi(u, v) - 0.4);
        stokes += e * e.transpose() / count;
        reduced += r * r.transpose() / count;
        const Eigen::Matrix3d covariance = state.stokes_covariance(u, v);
        expected_stokes += covariance / count;
        const StokesVariance quick = variances(u, v, state.stokes(u, v));
        EXPECT_NEAR(quick.intensity, covariance(0, 0), 1e-9 * covariance(0, 0));
        EXPECT_NEAR(quick.linear, 0.5 * (covariance(1, 1) + covariance(2, 2)), 1e-9 * covariance(1, 1));
        expected_reduced += state.covariance(u, v) / count;
        residual += state.residual(u, v) * state.residual(u, v) / count;
      }
    }
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        EXPECT_NEAR(stokes(i, j), expected_stokes(i, j),
                    0.04 * std::sqrt(expected_stokes(i, i) * expected_stokes(j, j)));
        EXPECT_NEAR(reduced(i, j), expected_reduced(i, j),
                    0.04 * std::sqrt(expected_reduced(i, i) * expected_reduced(j, j)));
      }
    }
    EXPECT_NEAR(residual, 1, 0.03);
  }
}

TEST(Decompose, DebiasedDegreeIsUnbiasedInTheSquare) {
  EXPECT_EQ(debiased_degree(0.01, 1), 0);
  EXPECT_NEAR(debiased_degree(0.05, 0.0009), 0.04, 1e-12);
}

TEST(Decompose, SingleAndDoublePrecisionAgreeInEveryQuadrant) {
  // The noise-weighted fit is in double precision. Without noise, both fits must find the same sinusoid.
  const Size size{720, 5};
  const auto truth = [](int u, int v) { return stokes_vector(0.05 + 0.1 * v, 0.4, u * std::numbers::pi / 720); };
  const auto angles = even_angles(6);
  const auto images = images_of(truth, size, angles, {}, 0);
  DecomposeOptions weighted;
  weighted.weighting = FitWeighting::noise;
  const auto single = decompose(images, angles, {}, full(size), {}, {}, {});
  const auto twice = decompose(images, angles, {}, full(size), {}, weighted, {});
  for (std::size_t i = 0; i < single.phi.count(); ++i) {
    EXPECT_NEAR(single.i_un[i], twice.i_un[i], 1e-6);
    EXPECT_NEAR(single.rho[i], twice.rho[i], 2e-6);
    EXPECT_NEAR(std::remainder(single.phi[i] - twice.phi[i], std::numbers::pi), 0, 2e-6);
    EXPECT_GE(single.phi[i], 0);
    EXPECT_LT(single.phi[i], std::numbers::pi);
  }
}

TEST(Decompose, SixteenBitImagesGiveTheSameFitAsFloatImages) {
  const Size size{301, 7};  // the last group of pixels is incomplete
  const auto truth = [](int u, int v) { return stokes_vector(0.1 + 0.001 * u, 0.1 + 0.1 * v, 0.01 * u); };
  const auto angles = even_angles(6);
  std::vector<Image<float>> rounded = images_of(truth, size, angles, {}, 0);
  std::vector<Image<std::uint16_t>> images;
  std::vector<const std::uint16_t*> pixels;
  for (Image<float>& image : rounded) {
    Image<std::uint16_t> counts(size);
    for (std::size_t i = 0; i < image.count(); ++i) {
      counts[i] = static_cast<std::uint16_t>(std::lround(65535 * image[i]));
      image[i] = static_cast<float>(counts[i] / 65535.0);
    }
    images.push_back(std::move(counts));
  }
  for (const auto& image : images) pixels.push_back(image.data());
  for (const auto weighting : {FitWeighting::uniform, FitWeighting::noise}) {
    DecomposeOptions options;
    options.weighting = weighting;
    const auto expected = decompose(rounded, angles, {}, full(size), {}, options, {});
    // Without a mask all pixels are fitted.
    const auto state = decompose(size, std::span<const std::uint16_t* const>(pixels), angles, {}, {}, {}, options, {});
    EXPECT_EQ(state.valid, expected.valid);
    for (std::size_t i = 0; i < size.area(); ++i) {
      EXPECT_NEAR(state.i_un[i], expected.i_un[i], 2e-7);
      EXPECT_NEAR(state.rho[i], expected.rho[i], 1e-6);
      EXPECT_NEAR(std::remainder(state.phi[i] - expected.phi[i], std::numbers::pi), 0, 1e-5);
      EXPECT_NEAR(state.residual[i], expected.residual[i], 1e-4);
    }
  }
}

TEST(Decompose, NormalizedResidualsAreOneForAnyNumberOfImages) {
  // Images are fitted in groups; the padding of the last group must not count. With hardly any polarization all images
  // have the same noise, so that the noise-weighted fit, which is in double precision, gives the same result.
  const Size size{40, 30};
  for (const int count : {4, 5, 6, 7, 13}) {
    const auto angles = even_angles(count);
    const auto images = images_of([](int, int) { return stokes_vector(0.4, 0.02, 1); }, size, angles, {}, 11);
    DecomposeOptions weighted;
    weighted.weighting = FitWeighting::noise;
    const auto single = decompose(images, angles, {}, full(size), {}, {}, {});
    const auto twice = decompose(images, angles, {}, full(size), {}, weighted, {});
    double square = 0, expected = 0;
    for (std::size_t i = 0; i < size.area(); ++i) {
      square += single.residual[i] * single.residual[i] / static_cast<double>(size.area());
      expected += twice.residual[i] * twice.residual[i] / static_cast<double>(size.area());
    }
    EXPECT_NEAR(square, 1, 0.15) << count;
    EXPECT_NEAR(square, expected, 0.02) << count;
  }
}

TEST(Decompose, APixelWithoutLightIsDarkAndNotPolarized) {
  const auto angles = even_angles(6);
  const std::vector<Image<float>> images(6, Image<float>({3, 1}, 1, 0.0f));
  NoiseModel noise;
  noise.read_noise_e = 0;
  const auto state = decompose(images, angles, noise, full({3, 1}), {}, {}, {});
  EXPECT_EQ(state.valid(1, 0), static_cast<std::uint8_t>(PixelState::dark));
  EXPECT_EQ(state.rho(1, 0), 0);
  EXPECT_EQ(state.phi(1, 0), 0);
  EXPECT_EQ(state.residual(1, 0), 0);
}

TEST(Decompose, SameResultWithOneAndThreeThreads) {
  const Size size{61, 47};
  const auto angles = even_angles(5);
  const auto images =
      images_of([](int u, int v) { return stokes_vector(0.3, 0.1, 0.01 * u * v); }, size, angles, {}, 9);
  const Context one_thread{}, three_threads{.threads = 3};
  const auto one = decompose(images, angles, {}, full(size), {}, {}, one_thread);
  const auto three = decompose(images, angles, {}, full(size), {}, {}, three_threads);
  EXPECT_EQ(one.rho, three.rho);
  EXPECT_EQ(one.phi, three.phi);
  EXPECT_EQ(one.valid, three.valid);
}

}  // namespace
}  // namespace malus
