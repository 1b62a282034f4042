#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"

namespace malus {

/// A keypoint of an image, memory pixel convention, and the point that it observes.
struct ColmapKeypoint {
  static constexpr std::uint64_t no_point = std::numeric_limits<std::uint64_t>::max();

  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  std::uint64_t point_id = no_point;
};

/// A registered image.
struct ColmapImage {
  std::string name;
  std::uint32_t camera_id = 0;
  Pose pose;  ///< cam_from_world
  std::vector<ColmapKeypoint> keypoints;
};

/// A triangulated point and where it was seen: (image id, index of the keypoint in that image).
struct ColmapPoint {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Rgb color{};
  double error_px = 0;  ///< mean reprojection error, −1 if unknown
  std::vector<std::pair<std::uint32_t, std::uint32_t>> track;
};

/// A COLMAP reconstruction, keyed by COLMAP's ids. Pixels are in the memory convention: this file's functions are the
/// only place that converts (COLMAP's pixel centers are at +0.5).
struct ColmapModel {
  std::map<std::uint32_t, LensCamera> cameras;
  std::map<std::uint32_t, ColmapImage> images;
  std::map<std::uint64_t, ColmapPoint> points;
  std::map<std::string, std::string> left_out;  ///< images whose camera's model is not supported, and that model

  /// Image with this name; otherwise an input error lists the existing names, or names the camera model that is not
  /// supported. `where` names file and field.
  const ColmapImage& image(const std::string& name, const std::string& where) const;
  /// Moves the model: x becomes scale · rotation · x + translation.
  void transform(double scale, const Eigen::Matrix3d& rotation, const Eigen::Vector3d& translation);
};

/// Which parts of a model to read; points and keypoints are most of its bytes.
enum class ColmapParts { cameras_and_images, everything };

/// Reads cameras, images and points3D from a folder, binary (preferred, as COLMAP does) or text, of COLMAP 3.x and 4.x
/// (rigs and frames are not needed and ignored). Without points3D the model has none. Images of fisheye cameras are
/// left out; points may still name them in their tracks.
/// Throws ErrorCode::input naming file and line or record: file missing or truncated, camera model not known, image of
/// an unknown camera, numbers that are not finite, a rotation of length zero.
ColmapModel read_colmap_model(const std::filesystem::path& folder, ColmapParts parts = ColmapParts::everything);

/// The files of a model's cameras and images that read_colmap_model reads. Throws ErrorCode::input if there are none.
std::vector<std::filesystem::path> colmap_model_files(const std::filesystem::path& folder);

/// Writes a binary model that COLMAP 3.8 and 4.x read, to an existing folder. Throws an input error for `brown`, which
/// COLMAP does not have.
void write_colmap_model(const std::filesystem::path& folder, const ColmapModel& model);

/// Content of a cameras.txt with one PINHOLE camera (id 1), and of an images.txt with one image (id 1) of this camera.
std::string colmap_text(const Pinhole& camera);
std::string colmap_text(const Pose& pose, const std::string& image_name);

/// Depth map (1 channel) or normal map (3) of COLMAP's dense stereo, `*.geometric.bin`: "w&h&c&", then float32, channel
/// after channel. Pixels without a value (all zeros there) are NaN.
Image<float> read_colmap_array(const std::filesystem::path& path);

/// Rotation of a quaternion (w, x, y, z), normalized here. `where` names file and field if it has no direction.
Eigen::Matrix3d rotation_from_quaternion(const std::array<double, 4>& wxyz, const std::string& where);
/// Unit quaternion (w, x, y, z), w ≥ 0, of a rotation.
std::array<double, 4> quaternion_from_rotation(const Eigen::Matrix3d& rotation);

/// Converts a camera from COLMAP's pixel convention to the memory pixel convention.
LensCamera from_colmap_pixels(LensCamera camera);

}  // namespace malus
