#include <algorithm>
#include <array>
#include <cmath>
#include <sstream>

#include "malus/core/length_unit_internal.h"
#include "malus/evidence/other_inputs_internal.h"

namespace malus {
namespace {

template <class T>
Image<T> undone(const Image<T>& image, const ImageTurn& turn) {
  Image<T> result(image.size(), image.channels());
  for_each_pixel(image.size(), [&](int u, int v) {
    const int from_u = turn.exchanges ? v : u, from_v = turn.exchanges ? u : v;
    result(u, v) =
        image(turn.flips_u ? image.width() - 1 - from_u : from_u, turn.flips_v ? image.height() - 1 - from_v : from_v);
  });
  return result;
}

constexpr std::size_t sampled_points = 5000;

/// Exchanges and negations of axes; those that change least come first.
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

}  // namespace

std::vector<ImageTurn> image_turns(Size size) {
  const std::string mirrored =
      "mirror the polarized images and the mask, or export the prior with its axes as they are";
  std::vector<ImageTurn> turns{
      {"the images are turned by 180°", "turn the polarized images and the mask by 180°", false, true, true},
      {"images and prior are mirrored against each other, left to right", mirrored, false, true, false},
      {"images and prior are mirrored against each other, top to bottom", mirrored, false, false, true}};
  if (size.width != size.height) return turns;
  turns.push_back({"the images are turned by 90° clockwise",
                   "turn the polarized images and the mask by 90° counter-clockwise", true, true, false});
  turns.push_back({"the images are turned by 90° counter-clockwise",
                   "turn the polarized images and the mask by 90° clockwise", true, false, true});
  return turns;
}

SceneView undone(const SceneView& scene, const ImageTurn& turn) {
  return {scene.factor,           scene.camera,           undone(scene.brightness, turn), undone(scene.seen, turn),
          undone(scene.s1, turn), undone(scene.s2, turn), undone(scene.variance, turn),   undone(scene.object, turn)};
}

CoverageCounter::CoverageCounter(const Pinhole& camera, const Mask& object, int cells_per_side)
    : camera_(camera),
      object_(object),
      cell_px_(std::max(1, std::max(camera.size.width, camera.size.height) / cells_per_side)),
      cells_with_object_({camera.size.width / cell_px_ + 1, camera.size.height / cell_px_ + 1}) {
  for_each_pixel(object, [&](int u, int v) { cells_with_object_(u / cell_px_, v / cell_px_) = 1; });
}

CloudCoverage CoverageCounter::operator()(const PointCloud& cloud, const Eigen::Affine3d& cam_from_cloud) const {
  CloudCoverage coverage;
  if (cloud.points.empty()) return coverage;
  Mask cells_with_point(cells_with_object_.size());
  const std::size_t stride = cloud.points.size() / sampled_points + 1;
  double points = 0;
  for (std::size_t i = 0; i < cloud.points.size(); i += stride) {
    ++points;
    const Eigen::Vector3d x = cam_from_cloud * cloud.points[i];
    if (!(x.z() > 0)) continue;
    const Eigen::Vector2d pixel = camera_.project(x);
    if (!(pixel.minCoeff() > -0.5 && pixel.x() < camera_.size.width - 0.5 && pixel.y() < camera_.size.height - 0.5))
      continue;
    ++coverage.in_view;
    const auto u = static_cast<int>(std::lround(pixel.x())), v = static_cast<int>(std::lround(pixel.y()));
    if (object_(u, v) == 0) continue;
    ++coverage.on_object;
    cells_with_point(u / cell_px_, v / cell_px_) = 1;
  }
  coverage.in_view /= points;
  coverage.on_object /= points;
  double objects = 0, hit = 0;
  for (std::size_t i = 0; i < cells_with_object_.count(); ++i) {
    objects += cells_with_object_[i];
    hit += cells_with_object_[i] * cells_with_point[i];
  }
  coverage.covered = objects > 0 ? hit / objects : 0;
  return coverage;
}

Eigen::Affine3d affine_of(const Pose& pose) {
  return Eigen::Translation3d(pose.translation) * Eigen::Affine3d(pose.rotation);
}

std::vector<MovedCloud> moved_clouds(const PointCloud& cloud, const Pose& pose, const CoverageCounter& coverage_of,
                                     const std::string& unit, std::size_t most) {
  const Eigen::Affine3d given = affine_of(pose);
  std::vector<MovedCloud> result;
  for (const LengthUnit& other : length_units) {
    if (other.name == unit) continue;
    const double scale = other.meters / length_unit(unit).meters;
    std::ostringstream text;
    text << "the cloud is in " << other.name << " and the camera in " << unit << " (a factor of " << scale << ")";
    result.push_back({text.str(), "give cloud and camera in the same unit", given * Eigen::Scaling(scale),
                      other.name == "ft" || other.name == "in" ? 0.3 : 1.0});
  }
  result.push_back({"the camera's pose goes the other way, from the camera into the world",
                    "give the pose from the world into the camera", given.inverse()});
  for (const Eigen::Matrix3d& axes : exchanged_axes()) {
    const std::string name = axes.determinant() < 0 ? "the cloud is mirrored" : "the axes of the cloud are exchanged";
    result.push_back({name + ", for example (x, y, z) for " + words_of(axes), "export the cloud with the camera's axes",
                      given * Eigen::Affine3d(axes)});
  }
  for (MovedCloud& idea : result) idea.coverage = coverage_of(cloud, idea.cam_from_cloud);
  std::ranges::stable_sort(result, std::ranges::greater{}, &MovedCloud::rank);
  result.resize(std::min(most, result.size()));
  return result;
}

}  // namespace malus
