#include <Eigen/Geometry>
#include <map>
#include <opencv2/aruco.hpp>

#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/io/nearest_name_internal.h"
#include "malus/photogrammetry/target_detection_internal.h"

namespace malus {
namespace {

const std::map<std::string, cv::aruco::PREDEFINED_DICTIONARY_NAME>& dictionaries() {
  static const std::map<std::string, cv::aruco::PREDEFINED_DICTIONARY_NAME> names{
      {"aruco_4x4_50", cv::aruco::DICT_4X4_50},           {"aruco_4x4_100", cv::aruco::DICT_4X4_100},
      {"aruco_4x4_250", cv::aruco::DICT_4X4_250},         {"aruco_4x4_1000", cv::aruco::DICT_4X4_1000},
      {"aruco_5x5_50", cv::aruco::DICT_5X5_50},           {"aruco_5x5_100", cv::aruco::DICT_5X5_100},
      {"aruco_5x5_250", cv::aruco::DICT_5X5_250},         {"aruco_5x5_1000", cv::aruco::DICT_5X5_1000},
      {"aruco_6x6_50", cv::aruco::DICT_6X6_50},           {"aruco_6x6_100", cv::aruco::DICT_6X6_100},
      {"aruco_6x6_250", cv::aruco::DICT_6X6_250},         {"aruco_6x6_1000", cv::aruco::DICT_6X6_1000},
      {"aruco_7x7_50", cv::aruco::DICT_7X7_50},           {"aruco_7x7_100", cv::aruco::DICT_7X7_100},
      {"aruco_7x7_250", cv::aruco::DICT_7X7_250},         {"aruco_7x7_1000", cv::aruco::DICT_7X7_1000},
      {"aruco_original", cv::aruco::DICT_ARUCO_ORIGINAL}, {"apriltag_16h5", cv::aruco::DICT_APRILTAG_16h5},
      {"apriltag_25h9", cv::aruco::DICT_APRILTAG_25h9},   {"apriltag_36h10", cv::aruco::DICT_APRILTAG_36h10},
      {"apriltag_36h11", cv::aruco::DICT_APRILTAG_36h11}};
  return names;
}

/// Crossing of the diagonals: under any projection it is the image of the square's center.
Eigen::Vector2d diagonal_crossing(const std::array<Eigen::Vector2d, 4>& corners) {
  const Eigen::Vector3d one = corners[0].homogeneous().cross(corners[2].homogeneous());
  const Eigen::Vector3d other = corners[1].homogeneous().cross(corners[3].homogeneous());
  return one.cross(other).hnormalized();
}

}  // namespace

std::vector<CodedTarget> detect_targets(const Image<std::uint8_t>& image, const std::string& dictionary) {
  const auto found = dictionaries().find(dictionary);
  if (found == dictionaries().end()) {
    std::vector<std::string_view> names;
    for (const auto& [name, number] : dictionaries()) names.push_back(name);
    throw input_error("targets_dictionary = \"" + dictionary + "\" is not known" +
                      hint_at_known_names(dictionary, names));
  }
  if (image.channels() != 1) throw input_error("targets are searched in images of one channel");
  const cv::Mat pixels = as_mat(image);
  const OpenCvThreads one_thread(1);  // like other functions without a Context
  const auto parameters = cv::aruco::DetectorParameters::create();
  parameters->cornerRefinementMethod = cv::aruco::CORNER_REFINE_SUBPIX;
  std::vector<int> ids;
  std::vector<std::vector<cv::Point2f>> quads;
  cv::aruco::detectMarkers(pixels, cv::aruco::getPredefinedDictionary(found->second), quads, ids, parameters);
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
