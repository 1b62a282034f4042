#include <Eigen/Geometry>
#include <opencv2/aruco.hpp>

#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/photogrammetry/target_detection_internal.h"

namespace malus {
namespace {

/// The same dictionary in OpenCV.
cv::aruco::PREDEFINED_DICTIONARY_NAME in_opencv(TargetDictionary dictionary) {
  static_assert(static_cast<int>(TargetDictionary::aruco_4x4_50) == cv::aruco::DICT_4X4_50 &&
                static_cast<int>(TargetDictionary::aruco_7x7_1000) == cv::aruco::DICT_7X7_1000 &&
                static_cast<int>(TargetDictionary::apriltag_16h5) == cv::aruco::DICT_APRILTAG_16h5 &&
                static_cast<int>(TargetDictionary::apriltag_36h11) == cv::aruco::DICT_APRILTAG_36h11);
  return static_cast<cv::aruco::PREDEFINED_DICTIONARY_NAME>(dictionary);
}

/// Crossing of the diagonals: under any projection it is the image of the square's center.
Eigen::Vector2d diagonal_crossing(const std::array<Eigen::Vector2d, 4>& corners) {
  const Eigen::Vector3d one = corners[0].homogeneous().cross(corners[2].homogeneous());
  const Eigen::Vector3d other = corners[1].homogeneous().cross(corners[3].homogeneous());
  return one.cross(other).hnormalized();
}

}  // namespace

std::vector<CodedTarget> detect_targets(const Image<std::uint8_t>& image, TargetDictionary dictionary) {
  if (image.channels() != 1) throw input_error("targets are searched in images of one channel");
  const cv::Mat pixels = as_mat(image);
  const OpenCvThreads one_thread(1);  // like other functions without a Context
  const auto parameters = cv::aruco::DetectorParameters::create();
  parameters->cornerRefinementMethod = cv::aruco::CORNER_REFINE_SUBPIX;
  std::vector<int> ids;
  std::vector<std::vector<cv::Point2f>> quads;
  cv::aruco::detectMarkers(pixels, cv::aruco::getPredefinedDictionary(in_opencv(dictionary)), quads, ids, parameters);
  std::vector<CodedTarget> targets;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    CodedTarget target;
    target.id = ids[i];
    for (std::size_t k = 0; k < 4; ++k) target.corners[k] = {quads[i][k].x, quads[i][k].y};
    target.center = diagonal_crossing(target.corners);
    targets.push_back(target);
  }
  return targets;
}

}  // namespace malus
