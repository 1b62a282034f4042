#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "malus/core/simd_internal.h"
#include "malus/stereo/view_projection_internal.h"

namespace malus {
namespace {

constexpr double outside = -1e6;

}  // namespace

ViewProjection::ViewProjection(const Pinhole& station, const Pose& station_pose, const LensCamera& camera,
                               const Pose& pose)
    : station_(station),
      view_from_station_(pose.rotation * station_pose.rotation.transpose()),
      translation_(pose.translation - view_from_station_ * station_pose.translation),
      center_in_station_(-view_from_station_.transpose() * translation_),
      raster_(camera.pinhole()) {
  fit_lens(camera);
}

void ViewProjection::fit_lens(const LensCamera& camera) {
  constexpr int side = 13;
  Eigen::MatrixXd rows(2 * side * side, 5);
  Eigen::VectorXd right(2 * side * side);
  int n = 0;
  for (int j = 0; j < side; ++j) {
    for (int i = 0; i < side; ++i) {
      const Eigen::Vector2d pixel(i * (camera.size.width - 1.0) / (side - 1),
                                  j * (camera.size.height - 1.0) / (side - 1));
      const Eigen::Vector2d ideal = camera.undistort(pixel);
      if (!ideal.allFinite()) continue;
      const double x = ideal.x(), y = ideal.y(), r2 = ideal.squaredNorm();
      max_r2_ = std::max(max_r2_, 1.05 * r2);
      rows.row(n) << x * r2, x * r2 * r2, x * r2 * r2 * r2, 2 * x * y, r2 + 2 * x * x;
      rows.row(n + 1) << y * r2, y * r2 * r2, y * r2 * r2 * r2, r2 + 2 * y * y, 2 * x * y;
      right.segment<2>(n) = raster_.ray(pixel.x(), pixel.y()).head<2>() - ideal;
      n += 2;
    }
  }
  rows.conservativeResize(n, Eigen::NoChange);
  right.conservativeResize(n);
  if (!camera.has_distortion()) return;
  // Columns differ in size by powers of the field's radius; scaling makes the system well conditioned.
  const Eigen::VectorXd scale = rows.colwise().norm().cwiseMax(1e-30).cwiseInverse();
  lens_ = scale.asDiagonal() * (rows * scale.asDiagonal()).colPivHouseholderQr().solve(right);
  fit_error_px_ = (rows * lens_ - right).cwiseAbs().maxCoeff() * focal();
}

Eigen::Vector2d ViewProjection::measured(const Eigen::Vector2d& ideal) const {
  const double x = ideal.x(), y = ideal.y(), r2 = ideal.squaredNorm();
  const double radial = 1 + r2 * (lens_[0] + r2 * (lens_[1] + r2 * lens_[2])), p1 = lens_[3], p2 = lens_[4];
  return raster_.project(
      {x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y, 1.0});
}

Eigen::Vector2d ViewProjection::project(double u, double v, double z) const {
  const Eigen::Vector3d point = z * (view_from_station_ * station_.ray(u, v)) + translation_;
  if (!(point.z() > 0)) return {outside, outside};
  const Eigen::Vector2d ideal = point.head<2>() / point.z();
  return ideal.squaredNorm() > max_r2_ ? Eigen::Vector2d(outside, outside) : measured(ideal);
}

double ViewProjection::depth_in_view(double u, double v, double z) const {
  return z * view_from_station_.row(2).dot(station_.ray(u, v)) + translation_.z();
}

MALUS_SIMD_CLONES
void ViewProjection::project_row(double u0, double v, double spacing, const float* z, std::size_t count, float* x,
                                 float* y) const {
  const Eigen::Vector3f start = (view_from_station_ * station_.ray(spacing * u0, spacing * v)).cast<float>();
  const Eigen::Vector3f step = (view_from_station_.col(0) * (spacing / station_.fx)).cast<float>();
  const Eigen::Vector3f shift = translation_.cast<float>();
  const auto fx = static_cast<float>(raster_.fx), fy = static_cast<float>(raster_.fy);
  const auto cx = static_cast<float>(raster_.cx), cy = static_cast<float>(raster_.cy);
  const Eigen::Matrix<float, 5, 1> lens = lens_.cast<float>();
  const float k1 = lens[0], k2 = lens[1], k3 = lens[2], p1 = lens[3], p2 = lens[4];
  const auto max_r2 = static_cast<float>(max_r2_);
  constexpr auto away = static_cast<float>(outside);
  for (std::size_t i = 0; i < count; ++i) {
    const auto at = static_cast<float>(static_cast<int>(i));
    const float inverse = 1.0F / (z[i] * (start.z() + at * step.z()) + shift.z());
    const float a = (z[i] * (start.x() + at * step.x()) + shift.x()) * inverse;
    const float b = (z[i] * (start.y() + at * step.y()) + shift.y()) * inverse;
    const float r2 = a * a + b * b, ab = 2.0F * a * b;
    const float radial = 1.0F + r2 * (k1 + r2 * (k2 + r2 * k3));
    const float px = fx * (a * radial + p1 * ab + p2 * (r2 + 2.0F * a * a)) + cx;
    const float py = fy * (b * radial + p1 * (r2 + 2.0F * b * b) + p2 * ab) + cy;
    const bool seen = (inverse > 0.0F) & (r2 <= max_r2);
    x[i] = seen ? px : away;
    y[i] = seen ? py : away;
  }
}

}  // namespace malus
