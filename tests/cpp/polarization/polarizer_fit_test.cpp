#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <numeric>

#include "malus/polarization/frame_calibration_internal.h"
#include "malus/polarization/polarizer_fit_internal.h"
#include "polarizer_scene.h"
#include "thrown_error.h"

namespace malus {
namespace {

const NoiseModel low_noise{.full_well_e = 20000, .read_noise_e = 8, .frames_averaged = 64};
const std::vector<double> nominal_deg{0, 30, 60, 90, 120, 150};

std::vector<double> radians(std::vector<double> degrees) {
  for (double& angle : degrees) angle *= degree_rad;
  return degrees;
}

PolarizerFit fit(const PolarizerScene& scene, const std::vector<double>& true_deg, const std::vector<double>& gains,
                 const std::vector<double>& given_deg, int threads = 2) {
  const Context context{.threads = threads};
  return fit_polarizer(scene.images(radians(true_deg), gains, low_noise), radians(given_deg), low_noise,
                       Mask(scene.size, 1, 255), {}, {}, context);
}

/// Largest error of the fitted angles and gains that does not depend on the frame of the Stokes vectors, which images
/// alone leave free.
double worst_product_error(const PolarizerFit& fit, const std::vector<double>& true_deg,
                           const std::vector<double>& gains) {
  // The Lorentz products of the rows do not depend on the frame, up to a common factor.
  const Eigen::MatrixX3d found = polarizer_rows(fit.angles_rad, fit.gains),
                         truth = polarizer_rows(radians(true_deg), gains);
  const Eigen::DiagonalMatrix<double, 3> lorentz(1, -1, -1);
  const Eigen::MatrixXd a = found * lorentz * found.transpose(), b = truth * lorentz * truth.transpose();
  return (a / a.norm() - b / b.norm()).cwiseAbs().maxCoeff();
}

TEST(PolarizerFit, CorrectsWrongAnglesAndExposuresUpToTheFrame) {
  const std::vector<double> angles{2.1, 28.2, 62.5, 88.3, 121.7, 147.9}, gains{1.02, 0.98, 1.01, 0.97, 1.03, 0.99};
  const PolarizerFit found = fit(PolarizerScene(true), angles, gains, nominal_deg);
  EXPECT_LT(worst_product_error(found, angles, gains), 1e-4);
  EXPECT_GT(found.improvement(), 0.5);
  EXPECT_NEAR(found.residual_after, 1, 0.1);
  const double log_gain = std::accumulate(found.gains.begin(), found.gains.end(), 0.0,
                                          [](double sum, double gain) { return sum + std::log(gain); });
  EXPECT_NEAR(log_gain, 0, 1e-6);
}

TEST(PolarizerFit, KeepsCorrectAngles) {
  const PolarizerFit found = fit(PolarizerScene(true), nominal_deg, std::vector<double>(6, 1.0), nominal_deg);
  EXPECT_LT(found.improvement(), 0.01);
  for (std::size_t k = 0; k < 6; ++k) {
    EXPECT_NEAR(found.angles_rad[k], nominal_deg[k] * degree_rad, 0.05 * degree_rad);
    EXPECT_NEAR(found.gains[k], 1, 1e-3);
  }
}

TEST(PolarizerFit, NoiseThatRegistrationSmoothedInSomeImagesIsNotTakenForAngles) {
  PolarizerScene scene;
  for (int v = 0; v < scene.size.height; ++v) {
    for (int u = 0; u < scene.size.width; ++u) {
      const float weak = 0.1F * 0.8F / scene.stokes(u, v, 0);
      scene.stokes(u, v, 0) = 0.8F;
      for (int c = 1; c < 3; ++c) scene.stokes(u, v, c) *= weak;
    }
  }
  NoiseModel single_frame = low_noise;
  single_frame.frames_averaged = 1;
  std::vector<Image<float>> images = scene.images(radians(nominal_deg), std::vector<double>(6, 1.0), single_frame);
  // All but the first are interpolated at half pixels, as those that moved against it.
  for (std::size_t k = 1; k < images.size(); ++k) {
    for (int v = 0; v + 1 < scene.size.height; ++v) {
      for (int u = 0; u + 1 < scene.size.width; ++u) {
        const Image<float>& image = images[k];
        images[k](u, v) = (image(u, v) + image(u + 1, v) + image(u, v + 1) + image(u + 1, v + 1)) / 4;
      }
    }
  }
  Mask small(scene.size);
  for (int v = 80; v < 184; ++v) std::fill_n(small.row(v) + 80, 104, std::uint8_t{255});
  const PolarizerFit found =
      fit_polarizer(images, radians(nominal_deg), single_frame, small, {}, PolarizerOptions{}, Context{});
  EXPECT_LT(found.largest_angle_change_rad, 5 * degree_rad);
  EXPECT_LT(found.improvement(), 0.25);
}

TEST(PolarizerFit, FindsCompletelyUnknownAngles) {
  const std::vector<double> angles{13, 171, 60, 95, 31, 128}, gains(6, 1.0);
  EXPECT_LT(worst_product_error(fit(PolarizerScene(true), angles, gains, {}), angles, gains), 1e-3);
}

TEST(PolarizerFit, UncertaintyOfTheCommonTurnIsThatOfTheNominalAngles) {
  const PolarizerFit found = fit(PolarizerScene(true), nominal_deg, std::vector<double>(6, 1.0), nominal_deg);
  const PolarizerCalibration stated = calibration_without_surface(found, true, true);
  for (std::size_t k = 0; k < 6; ++k) {
    // Images leave the common turn free: it is the mean of six nominal angles, each with a sigma of 2°.
    EXPECT_GT(stated.angles_sigma_deg[k], 2 / std::sqrt(6.0) * 0.99);
    EXPECT_LT(stated.angles_sigma_deg[k], 1.2);
  }
}

TEST(PolarizerFit, DoesNotDependOnThreads) {
  const std::vector<double> angles{1, 29, 61, 92, 119, 149}, gains(6, 1.0);
  const PolarizerScene scene;
  EXPECT_EQ(fit(scene, angles, gains, nominal_deg, 1).angles_rad, fit(scene, angles, gains, nominal_deg, 3).angles_rad);
}

TEST(PolarizerFit, ReadsAnObjectThatIsThinnerThanACell) {
  const std::vector<double> angles{2.1, 28.2, 62.5, 88.3, 121.7, 147.9}, gains(6, 1.0);
  const PolarizerScene scene(true);
  Mask wires(scene.size);
  for (int v = 0; v < scene.size.height; ++v)
    for (int u = 0; u < scene.size.width; u += 2) wires(u, v) = 255;
  const PolarizerFit found = fit_polarizer(scene.images(radians(angles), gains, low_noise), radians(nominal_deg),
                                           low_noise, wires, {}, {}, Context{});
  EXPECT_EQ(found.pixels, 320 * 240 / 2);
  EXPECT_LT(worst_product_error(found, angles, gains), 1e-3);
}

TEST(PolarizerFit, RefusesTooFewImagesAndMismatchedInput) {
  const PolarizerScene scene;
  const auto images = scene.images(radians({0, 45, 90, 135}), {1, 1, 1, 1}, low_noise);
  const Mask mask(scene.size, 1, 255);
  const auto fit = [&](const std::vector<double>& given, const Mask& object) {
    return [&] { fit_polarizer(images, given, low_noise, object, {}, {}, {}); };
  };
  expect_error(ErrorCode::data, fit({}, mask), "4 polarized images, expected at least 5");
  expect_error(ErrorCode::input, fit({0, 1}, mask));
  expect_error(ErrorCode::data, fit(radians({0, 45, 90, 135}), Mask(scene.size)));
  const double none = std::numeric_limits<double>::quiet_NaN();
  expect_error(ErrorCode::input, fit({0, 1, 2, none}, mask), "angle of polarized image 3 is not a finite number");
}

// No polarizer had a finite cost; the one without values that was then used ended the program.
TEST(PolarizerFit, RefusesNoiseThatIsTooSmallToComputeWith) {
  const PolarizerScene scene;
  const std::vector<double> angles = radians({0, 45, 90, 135});
  const auto images = scene.images(angles, {1, 1, 1, 1}, low_noise);
  const NoiseModel none{1e300, 0, 0, 1};
  expect_error(
      ErrorCode::data, [&] { fit_polarizer(images, angles, none, Mask(scene.size, 1, 255), {}, {}, {}); },
      "too small to compute with");
}

}  // namespace
}  // namespace malus
