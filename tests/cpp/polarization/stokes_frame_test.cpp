#include "malus/polarization/stokes_frame.h"

#include <gtest/gtest.h>

#include "malus/polarization/polarizer_calibration.h"
#include "polarizer_scene.h"

namespace malus {
namespace {

TEST(StokesFrame, KeepsTheCone) {
  const Eigen::Matrix3d lorentz = Eigen::Vector3d(1, -1, -1).asDiagonal();
  const StokesFrame frame = turned_scale(0.4) * boost(0.03, -0.2) * mirrored_scale();
  EXPECT_LT((frame.transpose() * lorentz * frame - lorentz).norm(), 1e-12);
  EXPECT_LT((boost(0.03, -0.2) * boost(-0.03, 0.2) - Eigen::Matrix3d::Identity()).norm(), 1e-12);
  EXPECT_NEAR(phase_of(turned_scale(0.3) * Eigen::Vector3d(1, std::cos(0.4), std::sin(0.4))), 0.5, 1e-6);
}

TEST(StokesFrame, FindsTurnAndScenePolarization) {
  for (const bool specular : {false, true}) {
    const PolarizerScene scene(specular);
    const StokesFrame wrong = turned_scale(2.5 * degree_rad) * boost(0.01, -0.006);
    const FrameEstimate found = estimate_frame(scene.state(wrong), nullptr, scene.normals, {}, {}, {});
    ASSERT_EQ(found.status, FrameStatus::ok);
    EXPECT_EQ(found.specular, specular);
    EXPECT_LT((found.frame * wrong - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff(), 1e-3) << specular;
    EXPECT_NEAR(found.values[2] / degree_rad, -2.5, 0.02);
    EXPECT_LT(found.mirror_ratio, 0.8);
  }
}

TEST(StokesFrame, FindsAnUnknownScale) {
  for (const bool specular : {false, true}) {
    for (const bool mirrored : {false, true}) {
      const PolarizerScene scene(specular);
      const StokesFrame mirror = mirrored ? mirrored_scale() : StokesFrame(StokesFrame::Identity());
      const StokesFrame wrong = mirror * turned_scale(67 * degree_rad) * boost(0.01, 0.01);
      FrameHints hints;
      hints.known_scale = false;
      const FrameEstimate found = estimate_frame(scene.state(wrong), nullptr, scene.normals, hints, {}, {});
      ASSERT_EQ(found.status, FrameStatus::ok);
      EXPECT_EQ(found.mirrored, mirrored);
      EXPECT_LT((found.frame * wrong - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff(), 1e-3)
          << specular << mirrored;
    }
  }
}

TEST(StokesFrame, SeesAScaleReadFromBehind) {
  const PolarizerScene scene;
  const FrameEstimate found = estimate_frame(scene.state(mirrored_scale()), nullptr, scene.normals, {}, {}, {});
  EXPECT_GT(found.mirror_ratio, 1.5);
}

TEST(StokesFrame, SaysWhenTheSurfaceIsFlat) {
  PolarizerScene scene;
  for (int i = 0; i < scene.size.width * scene.size.height; ++i) {
    const auto at = static_cast<std::size_t>(3 * i);
    scene.normals[at] = scene.normals[at + 1] = 0;
    scene.normals[at + 2] = -1;
  }
  const auto found = estimate_frame(scene.state(StokesFrame::Identity()), nullptr, scene.normals, {}, {}, {});
  EXPECT_EQ(found.status, FrameStatus::no_slopes);
}

/// Nominal angles 0, 30, …, exposures 1, as they are given.
PolarizerFit given_fit() {
  const std::vector<double> angles{0, 30 * degree_rad, 60 * degree_rad, 90 * degree_rad, 120 * degree_rad};
  return polarizer_as_given(angles, {});
}

FrameEstimate zero_error(double deg, double sigma_deg) {
  FrameEstimate estimate;
  estimate.status = FrameStatus::ok;
  estimate.values = {0.001, 0, deg * degree_rad};
  estimate.covariance = Eigen::Vector3d(1e-6, 1e-6, std::pow(sigma_deg * degree_rad, 2)).asDiagonal();
  estimate.frame = boost(0.001, 0) * turned_scale(deg * degree_rad);
  return estimate;
}

TEST(PolarizerCalibration, CorrectsAZeroThatIsClearlyOff) {
  const CalibratedFrame corrected = calibrate_frame(given_fit(), false, true, zero_error(2, 0.1), {});
  EXPECT_TRUE(corrected.calibration.from_surface);
  EXPECT_NEAR(corrected.calibration.angles_deg[1], 32, 1e-9);
  EXPECT_TRUE(corrected.calibration.warnings.empty());
  EXPECT_FALSE(calibrate_frame(given_fit(), false, true, zero_error(2, 1), {}).calibration.from_surface);
  EXPECT_FALSE(calibrate_frame(given_fit(), false, true, zero_error(0.3, 0.01), {}).calibration.from_surface);
}

TEST(PolarizerCalibration, OnlyWarnsWhenOff) {
  PolarizerOptions options;
  options.calibrate_angles = AngleCalibration::off;
  const PolarizerCalibration off = calibrate_frame(given_fit(), false, true, zero_error(2, 0.1), options).calibration;
  EXPECT_FALSE(off.from_surface);
  EXPECT_NEAR(off.angles_deg[1], 30, 1e-9);
  ASSERT_EQ(off.warnings.size(), 1u);
}

TEST(PolarizerCalibration, DoubtsTheDirection) {
  FrameEstimate estimate = zero_error(0, 0.1);
  estimate.mirror_ratio = 2;
  const PolarizerCalibration doubted = calibrate_frame(given_fit(), false, true, estimate, {}).calibration;
  ASSERT_EQ(doubted.warnings.size(), 1u);
  EXPECT_NE(doubted.warnings[0].find("angle_direction"), std::string::npos);
}

TEST(PolarizerCalibration, SurfaceSharpensWhatImagesCannotTell) {
  const PolarizerScene scene(true);
  const std::vector<double> angles{1 * degree_rad,  28 * degree_rad,  62 * degree_rad,
                                   91 * degree_rad, 118 * degree_rad, 151 * degree_rad};
  const std::vector<double> nominal{
      0, 30 * degree_rad, 60 * degree_rad, 90 * degree_rad, 120 * degree_rad, 150 * degree_rad};
  const std::vector<double> gains{1.02, 0.99, 0.98, 1.01, 1.005, 0.995};
  const NoiseModel noise{.full_well_e = 20000, .read_noise_e = 8, .frames_averaged = 64};
  const PolarizerFit fit =
      fit_polarizer(scene.images(angles, gains, noise), nominal, noise, Mask(scene.size, 1, 255), {}, {}, {});
  const Eigen::MatrixX3d found = polarizer_rows(fit.angles_rad, fit.gains), truth = polarizer_rows(angles, gains);
  // The frame that the fit ended in: truth = found · wrong.
  const StokesFrame wrong = found.completeOrthogonalDecomposition().solve(truth);
  const FrameEstimate surface = estimate_frame(scene.state(wrong), nullptr, scene.normals, {}, {}, {});
  const PolarizerCalibration result = calibrate_frame(fit, true, true, surface, {}).calibration;
  double mean = 0;
  for (const double gain : gains) mean += std::log(gain) / 6;
  for (std::size_t k = 0; k < 6; ++k) {
    EXPECT_NEAR(std::remainder(result.angles_deg[k] - angles[k] / degree_rad, 180), 0, 0.05);
    EXPECT_NEAR(result.gains[k], gains[k] / std::exp(mean), 1.5e-3);
    EXPECT_LT(result.angles_sigma_deg[k], 0.3);
    EXPECT_LT(result.gains_sigma[k], 3e-3);
  }
}

}  // namespace
}  // namespace malus
