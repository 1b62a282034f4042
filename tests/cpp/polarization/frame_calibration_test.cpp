#include <gtest/gtest.h>

#include <utility>

#include "malus/polarization/frame_calibration_internal.h"
#include "polarizer_scene.h"
#include "thrown_error.h"

namespace malus {
namespace {

/// The polarizer as given: nominal angles 0, 30, … and exposures 1.
PolarizerFit given_fit() {
  const std::vector<double> angles{0, 30 * degree_rad, 60 * degree_rad, 90 * degree_rad, 120 * degree_rad};
  return polarizer_as_given(angles, {});
}

FrameEstimate zero_error(double deg, double sigma_deg) {
  FrameEstimate estimate;
  estimate.status = FrameStatus::ok;
  estimate.coherence.direct = 0.8;
  estimate.coherence.ahead_sigma = 0.1;
  estimate.values = {0.001, 0, deg * degree_rad};
  estimate.covariance = Eigen::Vector3d(1e-6, 1e-6, std::pow(sigma_deg * degree_rad, 2)).asDiagonal();
  estimate.frame = boost(0.001, 0) * turned_scale(deg * degree_rad);
  return estimate;
}

TEST(PolarizerCalibration, CorrectsAZeroThatIsClearlyOff) {
  const CalibratedFrame corrected = calibrate_frame(given_fit(), false, true, zero_error(2, 0.1), {});
  EXPECT_TRUE(corrected.calibration.from_surface);
  EXPECT_EQ(corrected.calibration.doubt, "");
  EXPECT_NEAR(corrected.calibration.angles_deg[1], 32, 1e-9);
  ASSERT_EQ(corrected.calibration.warnings.size(), 1u);
  expect_contains(corrected.calibration.warnings[0], "is corrected: angles as read are 2° ± 0.1° too small");
  EXPECT_FALSE(calibrate_frame(given_fit(), false, true, zero_error(2, 1), {}).calibration.from_surface);
  EXPECT_FALSE(calibrate_frame(given_fit(), false, true, zero_error(0.3, 0.01), {}).calibration.from_surface);
}

TEST(PolarizerCalibration, OnlyWarnsIfCalibrationIsOff) {
  PolarizerOptions options;
  options.calibrate_angles = AngleCalibration::off;
  const PolarizerCalibration off = calibrate_frame(given_fit(), false, true, zero_error(2, 0.1), options).calibration;
  EXPECT_FALSE(off.from_surface);
  EXPECT_NEAR(off.angles_deg[1], 30, 1e-9);
  ASSERT_EQ(off.warnings.size(), 1u);
}

TEST(PolarizerCalibration, ATurnNeedsTheSameEvidenceIfAnglesAreCalibrated) {
  for (const AngleCalibration calibrate : {AngleCalibration::automatic, AngleCalibration::on}) {
    PolarizerOptions options;
    options.calibrate_angles = calibrate;
    for (const auto& [error_deg, sigma_deg] : {std::pair(2.0, 1.0), {0.3, 0.01}}) {
      const CalibratedFrame kept = calibrate_frame(given_fit(), true, true, zero_error(error_deg, sigma_deg), options);
      EXPECT_NEAR(kept.calibration.angles_deg[1], 30, 0.05);
    }
    const CalibratedFrame turned = calibrate_frame(given_fit(), true, true, zero_error(2, 0.1), options);
    EXPECT_NEAR(turned.calibration.angles_deg[1], 32, 0.1);
  }
}

/// The estimate for a scene whose Stokes vectors are in a wrong frame.
FrameEstimate seen_in(const StokesFrame& wrong, bool specular) {
  const PolarizerScene scene(specular);
  return estimate_frame(scene.state(wrong), nullptr, scene.normals, {}, {}, {});
}

TEST(PolarizerCalibration, AScaleThatCountsTheOtherWayIsAnError) {
  const FrameEstimate behind = seen_in(mirrored_scale(), false);
  expect_error(
      ErrorCode::input, [&] { calibrate_frame(given_fit(), false, true, behind, {}); }, "angle_direction = \"cw\"");
  PolarizerOptions options;
  options.calibrate_angles = AngleCalibration::off;
  const PolarizerCalibration said = calibrate_frame(given_fit(), false, true, behind, options).calibration;
  ASSERT_EQ(said.warnings.size(), 1u);
  expect_contains(said.warnings[0], "angle_direction");
  EXPECT_EQ(said.doubt, said.warnings[0]);
  EXPECT_TRUE(said.is_contradicted);
  EXPECT_FALSE(said.from_surface);
}

TEST(PolarizerCalibration, AZeroOffBy90DegreesIsAnErrorIfCertain) {
  expect_error(
      ErrorCode::input,
      [] { calibrate_frame(given_fit(), false, true, seen_in(turned_scale(90 * degree_rad), true), {}); },
      "angle_zero_deg is off by 90°");
  const auto doubted = calibrate_frame(given_fit(), false, true, seen_in(turned_scale(90 * degree_rad), false), {});
  ASSERT_EQ(doubted.calibration.warnings.size(), 1u);
  expect_contains(doubted.calibration.warnings[0], "is angle_zero_deg off by 90°?");
  EXPECT_EQ(doubted.calibration.doubt, doubted.calibration.warnings[0]);
  EXPECT_FALSE(doubted.calibration.is_contradicted);
  EXPECT_FALSE(doubted.calibration.from_surface);
}

TEST(PolarizerCalibration, AnglesFixedInASensorAreNotCorrectedButCanBeWrong) {
  const PolarizerCalibration fixed =
      calibrate_frame(given_fit(), false, true, zero_error(2, 0.1), {}, true).calibration;
  EXPECT_FALSE(fixed.from_surface);
  EXPECT_NEAR(fixed.angles_deg[1], 30, 1e-9);
  EXPECT_EQ(fixed.doubt, "") << "of a few degrees";
  const FrameEstimate turned = seen_in(turned_scale(90 * degree_rad), true);
  expect_error(
      ErrorCode::input, [&] { calibrate_frame(given_fit(), false, true, turned, {}, true); }, "in a mosaic");
  PolarizerOptions off;
  off.calibrate_angles = AngleCalibration::off;
  expect_contains(calibrate_frame(given_fit(), false, true, turned, off, true).calibration.doubt, "is off by 90°");
}

TEST(PolarizerCalibration, TheSurfaceDeterminesTheFrameThatImagesLeaveFree) {
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
  // The frame of the fitted rows: truth = found · wrong.
  const StokesFrame wrong = found.completeOrthogonalDecomposition().solve(truth);
  const FrameEstimate surface = estimate_frame(scene.state(wrong), nullptr, scene.normals, {}, {}, {});
  const PolarizerCalibration result = calibrate_frame(fit, true, true, surface, {}).calibration;
  double mean = 0, turn = 0;
  for (std::size_t k = 0; k < 6; ++k) {
    mean += std::log(gains[k]) / 6;
    turn += std::remainder(result.angles_deg[k] - angles[k] / degree_rad, 180) / 6;
  }
  EXPECT_LT(std::abs(turn), 0.3);  // The nominal angles' mean error of .17° is too small for correcting a known scale.
  for (std::size_t k = 0; k < 6; ++k) {
    EXPECT_NEAR(std::remainder(result.angles_deg[k] - angles[k] / degree_rad, 180), turn, 0.05);
    EXPECT_NEAR(result.gains[k], gains[k] / std::exp(mean), 1.5e-3);
    EXPECT_LT(result.angles_sigma_deg[k], 0.3);
    EXPECT_LT(result.gains_sigma[k], 3e-3);
  }
}

}  // namespace
}  // namespace malus
