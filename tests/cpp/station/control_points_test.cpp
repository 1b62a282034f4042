#include <gtest/gtest.h>

#include "malus/station/control_points_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

/// A camera at the origin that looks along z, and control points whose marks are off by the given pixels along u.
StationFile marked(const std::vector<std::tuple<std::string, double, bool>>& points) {
  StationFile station;
  station.camera = CameraSpec{{LensModel::pinhole, {20, 10}, {10, 10, 9.5, 4.5}}, {}};
  for (const auto& [name, off, check] : points)
    station.control.push_back({name, {0, 0, 5}, std::array{9.5 + off, 4.5}, {}, check});
  return station;
}

TEST(ControlPoints, TheFitIsComputedFromThePointsThatGaveThePose) {
  StationFile station = marked({{"A", 3, false}, {"B", 4, false}, {"F", 60, true}});
  station.resection = Resection{};
  EXPECT_NEAR(control_json(station)["rms_px"].get<double>(), std::sqrt(12.5), 1e-9);
  EXPECT_NEAR(control_json(station)["check_rms_px"].get<double>(), 60, 1e-9);
  expect_contains(describe_control(station), "marks fit to 3.54 px, those held out to 60 px: A 3, B 4, F (check) 60");
  station.resection.reset();  // with a known pose all points check it
  EXPECT_NEAR(control_json(station)["rms_px"].get<double>(), std::sqrt((9 + 16 + 3600) / 3.0), 1e-9);
  EXPECT_TRUE(control_json(station)["check_rms_px"].is_null());
}

TEST(ControlPoints, APointBehindTheCameraHasNoError) {
  StationFile station = marked({{"A", 2, false}, {"B", 1, false}});
  station.control[1].xyz[2] = -5;
  EXPECT_NEAR(control_json(station)["rms_px"].get<double>(), 2, 1e-9);
  const std::string said = describe_control(station);
  expect_contains(said, "marks fit to 2 px: A 2, B behind the camera");
  station.control[0].xyz[2] = -5;
  EXPECT_TRUE(control_json(station)["rms_px"].is_null());
  EXPECT_EQ(describe_control(station).find("nan"), std::string::npos) << describe_control(station);
}

}  // namespace
}  // namespace malus
