#include "survey.h"

#include <malus/polarization/fresnel.h>
#include <malus/polarization/ray_frame.h>

#include <cmath>
#include <numbers>
#include <random>

namespace {

constexpr double pi = std::numbers::pi;
constexpr malus::Size size{144, 108};
constexpr double focal = 2000, distance = 1000, refractive_index = 1.5;
constexpr double mark_error_px = 0.3, image_noise = 0.002;
constexpr int point_spacing_px = 2;

/// Point of the plate at a pixel of the polarized view, in its camera frame.
Eigen::Vector3d true_point(double u, double v) {
  return true_depth(u, v) * polarized_view().camera.ray(u, v);
}

/// Photos from the left, the right and below.
std::vector<View> photos() {
  std::vector<View> views;
  const View middle = polarized_view();
  for (const Eigen::Vector2d& aside : {Eigen::Vector2d(-300, 0), Eigen::Vector2d(300, 0), Eigen::Vector2d(0, 300)}) {
    View view = middle;
    const Eigen::Vector3d towards = Eigen::Vector3d(-aside.x(), -aside.y(), distance).normalized();
    const Eigen::Matrix3d turn =
        Eigen::Quaterniond::FromTwoVectors(towards, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    view.pose.rotation = turn * middle.pose.rotation;
    view.pose.translation = turn * (middle.pose.translation - Eigen::Vector3d(aside.x(), aside.y(), 0));
    views.push_back(view);
  }
  return views;
}

/// Linear forward intersection with two equations per mark.
Eigen::Vector3d intersect(const std::vector<View>& views, const std::vector<Eigen::Vector2d>& marks) {
  Eigen::MatrixX3d a(2 * views.size(), 3);
  Eigen::VectorXd b(2 * views.size());
  for (std::size_t i = 0; i < views.size(); ++i) {
    const auto& [camera, pose] = views[i];
    const Eigen::Vector3d ray = camera.ray(marks[i].x(), marks[i].y());
    for (int axis = 0; axis < 2; ++axis) {
      const auto row = static_cast<Eigen::Index>(2 * i) + axis;
      a.row(row) = pose.rotation.row(axis) - ray[axis] * pose.rotation.row(2);
      b[row] = ray[axis] * pose.translation.z() - pose.translation[axis];
    }
  }
  return a.colPivHouseholderQr().solve(b);
}

}  // namespace

View polarized_view() {
  malus::Pose pose;
  pose.rotation = Eigen::AngleAxisd(0.3, Eigen::Vector3d(1, 2, 0.5).normalized()).toRotationMatrix();
  pose.translation = {40, -25, 300};
  return {{size, focal, focal, (size.width - 1) / 2.0, (size.height - 1) / 2.0}, pose};
}

double true_depth(double u, double v) {
  return distance - 1.5 * std::sin(2 * pi * u / 30) * std::cos(2 * pi * v / 36) - 0.5 * std::sin(2 * pi * (u + v) / 13);
}

Eigen::Vector3d true_normal(double u, double v) {
  constexpr double h = 1e-3;
  const Eigen::Vector3d along_u = true_point(u + h, v) - true_point(u - h, v);
  const Eigen::Vector3d along_v = true_point(u, v + h) - true_point(u, v - h);
  return along_v.cross(along_u).normalized();
}

std::vector<malus::Image<float>> polarized_images(const std::vector<double>& angles_deg) {
  const malus::Pinhole camera = polarized_view().camera;
  const Eigen::Vector3d light = Eigen::Vector3d(0.4, -0.5, -0.77).normalized();
  std::mt19937 random(1);
  std::normal_distribution<double> noise(0, image_noise);
  std::vector<malus::Image<float>> images(angles_deg.size(), malus::Image<float>(size));
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      const Eigen::Vector3d normal = true_normal(u, v);
      const malus::Slopes slopes = malus::ray_frame(camera.ray(u, v)).slopes(normal);
      const double degree = malus::diffuse_degree(std::atan(std::sqrt(slopes.tan2())), refractive_index);
      const double intensity = 0.6 * (0.15 + std::max(normal.dot(light), 0.0));
      for (std::size_t k = 0; k < images.size(); ++k) {
        const double turn = angles_deg[k] * pi / 180 - slopes.azimuth_rad();
        images[k](u, v) = static_cast<float>(intensity * (1 + degree * std::cos(2 * turn)) + noise(random));
      }
    }
  }
  return images;
}

malus::PointCloud intersected_points() {
  const malus::Pose pose = polarized_view().pose;
  const std::vector<View> views = photos();
  std::mt19937 random(2);
  std::normal_distribution<double> error(0, mark_error_px);
  malus::PointCloud cloud;
  for (int v = 0; v < size.height; v += point_spacing_px) {
    for (int u = 0; u < size.width; u += point_spacing_px) {
      std::vector<Eigen::Vector2d> marks;
      for (const View& view : views) {
        const Eigen::Vector3d seen = view.pose.cam_from_world(pose.world_from_cam(true_point(u, v)));
        marks.push_back(view.camera.project(seen) + Eigen::Vector2d(error(random), error(random)));
      }
      cloud.points.push_back(intersect(views, marks));
    }
  }
  return cloud;
}
