#include <gtest/gtest.h>

#include <opencv2/aruco.hpp>
#include <opencv2/imgproc.hpp>

#include "malus/photogrammetry/target_detection_internal.h"

namespace malus {
namespace {

constexpr int side = 200;

/// Image of 640 × 480 pixels of a target with a white border, transformed by the homography `view`.
Image<std::uint8_t> photo_of_target(int id, cv::aruco::PREDEFINED_DICTIONARY_NAME dictionary, const cv::Matx33d& view) {
  cv::Mat target;
  cv::aruco::drawMarker(cv::aruco::getPredefinedDictionary(dictionary), id, side, target, 1);
  cv::Mat page(480, 640, CV_8U, cv::Scalar(230));
  target.copyTo(page(cv::Rect(100, 100, side, side)));
  Image<std::uint8_t> image({640, 480});
  cv::Mat seen(480, 640, CV_8U, image.data());
  cv::warpPerspective(page, seen, view, seen.size(), cv::INTER_AREA, cv::BORDER_CONSTANT, cv::Scalar(230));
  return image;
}

TEST(DetectTargets, FindsNumberAndCenterUnderPerspective) {
  const cv::Matx33d view(0.8, -0.12, 60, 0.15, 0.7, 30, 3e-4, 2e-4, 1);
  // The square's center lies between pixels.
  const cv::Vec3d center = view * cv::Vec3d(100 + side / 2.0 - 0.5, 100 + side / 2.0 - 0.5, 1);
  for (const auto& [ours, dictionary] : {std::pair{TargetDictionary::aruco_4x4_50, cv::aruco::DICT_4X4_50},
                                         std::pair{TargetDictionary::apriltag_36h11, cv::aruco::DICT_APRILTAG_36h11}}) {
    const auto targets = detect_targets(photo_of_target(7, dictionary, view), ours);
    ASSERT_EQ(targets.size(), 1U) << enum_name(ours);
    EXPECT_EQ(targets[0].id, 7);
    EXPECT_NEAR(targets[0].center.x(), center[0] / center[2], 0.15) << enum_name(ours);
    EXPECT_NEAR(targets[0].center.y(), center[1] / center[2], 0.15) << enum_name(ours);
  }
}

TEST(DetectTargets, FindsNothingInAnEmptyPhoto) {
  EXPECT_TRUE(detect_targets(Image<std::uint8_t>({320, 240}, 1, 128), TargetDictionary::aruco_4x4_50).empty());
}

}  // namespace
}  // namespace malus
