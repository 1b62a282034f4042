#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <sstream>

#include "malus/core/length_unit.h"
#include "malus/evidence/other_inputs_internal.h"

namespace malus {
namespace {

/// Pixel of the image as it came that shows what the image as it would be has at (u, v).
using PixelOf = std::function<std::pair<int, int>(int u, int v)>;

template <class T>
Image<T> moved(const Image<T>& image, const PixelOf& pixel_of) {
  Image<T> result(image.size(), image.channels());
  for (int v = 0; v < image.height(); ++v) {
    for (int u = 0; u < image.width(); ++u) {
      const auto [from_u, from_v] = pixel_of(u, v);
      result(u, v) = image(from_u, from_v);
    }
  }
  return result;
}

/// Polarization stays as it is: exp(4i phase), which is compared, is the same after a quarter turn.
SceneView moved(const SceneView& scene, const PixelOf& pixel_of) {
  return {scene.factor,
          moved(scene.brightness, pixel_of),
          moved(scene.seen, pixel_of),
          moved(scene.s1, pixel_of),
          moved(scene.s2, pixel_of),
          moved(scene.variance, pixel_of),
          moved(scene.object, pixel_of)};
}

constexpr std::size_t sampled_points = 5000;
constexpr int cells_per_side = 32;

/// Those that leave most as it is come first.
std::vector<Eigen::Matrix3d> exchanged_axes() {
  std::vector<Eigen::Matrix3d> result;
  std::array<int, 3> order{0, 1, 2};
  do {
    for (int signs = 0; signs < 8; ++signs) {
      Eigen::Matrix3d axes = Eigen::Matrix3d::Zero();
      for (int row = 0; row < 3; ++row)
        axes(row, order[static_cast<std::size_t>(row)]) = (signs >> row & 1) != 0 ? -1 : 1;
      if (!axes.isIdentity()) result.push_back(axes);
    }
  } while (std::ranges::next_permutation(order).found);
  std::ranges::stable_sort(result, std::ranges::greater{}, [](const Eigen::Matrix3d& axes) { return axes.trace(); });
  return result;
}

std::string words_of(const Eigen::Matrix3d& axes) {
  std::string text = "(";
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      if (axes(row, column) == 0) continue;
      text += row > 0 ? ", " : "";
      text += axes(row, column) < 0 ? "-" : "";
      text += "xyz"[column];
    }
  }
  return text + ")";
}

Eigen::Affine3d linear(const Eigen::Matrix3d& matrix) {
  Eigen::Affine3d affine = Eigen::Affine3d::Identity();
  affine.linear() = matrix;
  return affine;
}

/// Some thousand of the points, so that each of many ideas takes a millisecond.
PointCloud sample_of(const PointCloud& cloud) {
  PointCloud sample;
  const std::size_t stride = cloud.points.size() / sampled_points + 1;
  for (std::size_t i = 0; i < cloud.points.size(); i += stride) sample.points.push_back(cloud.points[i]);
  return sample;
}

}  // namespace

std::vector<TurnedScene> turned_scenes(const SceneView& scene) {
  const int right = scene.size().width - 1, bottom = scene.size().height - 1;
  std::vector<TurnedScene> result;
  const auto add = [&](const std::string& what, const std::string& remedy, const PixelOf& pixel_of) {
    result.push_back({what, remedy, moved(scene, pixel_of)});
  };
  add("the images are turned by 180°", "turn the polarized images and the mask by 180°",
      [=](int u, int v) { return std::pair(right - u, bottom - v); });
  add("images and prior are mirrored against each other, left to right",
      "mirror the polarized images and the mask, or export the prior with its axes as they are",
      [=](int u, int v) { return std::pair(right - u, v); });
  add("images and prior are mirrored against each other, top to bottom",
      "mirror the polarized images and the mask, or export the prior with its axes as they are",
      [=](int u, int v) { return std::pair(u, bottom - v); });
  if (right != bottom) return result;
  add("the images are turned by 90° clockwise", "turn the polarized images and the mask by 90° counter-clockwise",
      [=](int u, int v) { return std::pair(right - v, u); });
  add("the images are turned by 90° counter-clockwise", "turn the polarized images and the mask by 90° clockwise",
      [=](int u, int v) { return std::pair(v, bottom - u); });
  return result;
}

CloudCoverage cloud_coverage(const PointCloud& cloud, const Pinhole& camera, const Eigen::Affine3d& cam_from_cloud,
                             const Mask& object) {
  CloudCoverage coverage;
  if (cloud.points.empty()) return coverage;
  const int cell_px = std::max(1, std::max(camera.size.width, camera.size.height) / cells_per_side);
  const Size cells{camera.size.width / cell_px + 1, camera.size.height / cell_px + 1};
  Mask has_point(cells), has_object(cells);
  for (int v = 0; v < object.height(); ++v)
    for (int u = 0; u < object.width(); ++u)
      if (object(u, v) != 0) has_object(u / cell_px, v / cell_px) = 1;
  const std::size_t stride = cloud.points.size() / sampled_points + 1;
  double points = 0;
  for (std::size_t i = 0; i < cloud.points.size(); i += stride) {
    ++points;
    const Eigen::Vector3d x = cam_from_cloud * cloud.points[i];
    if (!(x.z() > 0)) continue;
    const Eigen::Vector2d pixel = camera.project(x);
    if (!(pixel.minCoeff() > -0.5 && pixel.x() < camera.size.width - 0.5 && pixel.y() < camera.size.height - 0.5))
      continue;
    ++coverage.in_view;
    const auto u = static_cast<int>(std::lround(pixel.x())), v = static_cast<int>(std::lround(pixel.y()));
    if (object(u, v) == 0) continue;
    ++coverage.on_object;
    has_point(u / cell_px, v / cell_px) = 1;
  }
  coverage.in_view /= points;
  coverage.on_object /= points;
  double objects = 0, hit = 0;
  for (std::size_t i = 0; i < has_object.count(); ++i) {
    objects += has_object[i];
    hit += has_object[i] * has_point[i];
  }
  coverage.covered = objects > 0 ? hit / objects : 0;
  return coverage;
}

Eigen::Affine3d affine_of(const Pose& pose) {
  Eigen::Affine3d affine = Eigen::Affine3d::Identity();
  affine.linear() = pose.rotation;
  affine.translation() = pose.translation;
  return affine;
}

std::vector<MovedCloud> moved_clouds(const PointCloud& cloud, const Pose& pose, const Pinhole& camera,
                                     const Mask& object, const std::string& unit, std::size_t most) {
  const Eigen::Affine3d given = affine_of(pose);
  std::vector<MovedCloud> result;
  for (const LengthUnit& other : length_units) {
    if (other.name == unit) continue;
    const double scale = other.metres / length_unit(unit).metres;
    std::ostringstream text;
    text << "the cloud is in " << other.name << " and the camera in " << unit << " (a factor of " << scale << ")";
    result.push_back({text.str(), "give cloud and camera in the same unit",
                      given * linear(scale * Eigen::Matrix3d::Identity()),
                      other.name == "ft" || other.name == "in" ? 0.3 : 1.0});
  }
  result.push_back({"the camera's pose goes the other way, from the camera into the world",
                    "give the pose from the world into the camera", given.inverse()});
  for (const Eigen::Matrix3d& axes : exchanged_axes()) {
    const std::string name = axes.determinant() < 0 ? "the cloud is mirrored" : "the axes of the cloud are exchanged";
    result.push_back({name + ", for example (x, y, z) for " + words_of(axes), "export the cloud with the camera's axes",
                      given * linear(axes)});
  }
  const PointCloud sample = sample_of(cloud);
  for (MovedCloud& idea : result) idea.coverage = cloud_coverage(sample, camera, idea.cam_from_cloud, object);
  std::ranges::stable_sort(result, std::ranges::greater{}, &MovedCloud::rank);
  result.resize(std::min(most, result.size()));
  return result;
}

}  // namespace malus
