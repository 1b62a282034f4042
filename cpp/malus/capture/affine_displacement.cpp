#include <algorithm>
#include <array>
#include <cmath>

#include "malus/capture/affine_displacement_internal.h"

namespace malus {
namespace {

std::array<Eigen::Vector2d, 5> corners_and_center(Size size) {
  const double right = size.width - 1, bottom = size.height - 1;
  return {{{0, 0}, {right, 0}, {0, bottom}, {right, bottom}, {0.5 * right, 0.5 * bottom}}};
}

}  // namespace

Affine displaced(const Affine& map, const Vector6& p, Size size) {
  const double w = size.width, cu = 0.5 * (size.width - 1), cv = 0.5 * (size.height - 1);
  Eigen::Matrix2d linear = Eigen::Matrix2d::Identity();
  linear(0, 0) += p[2] / w;
  linear(0, 1) += p[3] / w;
  linear(1, 0) += p[4] / w;
  linear(1, 1) += p[5] / w;
  const Eigen::Vector2d shift(p[0] - (p[2] * cu + p[3] * cv) / w, p[1] - (p[4] * cu + p[5] * cv) / w);
  Affine result;
  result.leftCols<2>() = map.leftCols<2>() * linear;
  result.col(2) = map.leftCols<2>() * shift + map.col(2);
  return result;
}

double mean_square_displacement(const Matrix6& covariance, Size size) {
  const double w = size.width;
  double sum = 0;
  for (const Eigen::Vector2d& corner : corners_and_center(size)) {
    const double x = (corner.x() - 0.5 * (size.width - 1)) / w, y = (corner.y() - 0.5 * (size.height - 1)) / w;
    Vector6 along_u, along_v;
    along_u << 1, 0, x, y, 0, 0;
    along_v << 0, 1, 0, 0, x, y;
    sum += along_u.dot(covariance * along_u) + along_v.dot(covariance * along_v);
  }
  return sum / 5;
}

double affine_distance_px(const Affine& a, const Affine& b, Size size) {
  double sum = 0;
  for (const Eigen::Vector2d& corner : corners_and_center(size)) {
    sum += ((a - b).leftCols<2>() * corner + (a - b).col(2)).squaredNorm();
  }
  return std::sqrt(sum / 5);
}

PixelRect common_region(const std::vector<Affine>& maps, Size size, int margin) {
  double left = 0, top = 0, right = 0, bottom = 0;
  for (const Affine& map : maps) {
    for (const Eigen::Vector2d& corner : corners_and_center(size)) {
      const Eigen::Vector2d moved = map.leftCols<2>() * corner + map.col(2) - corner;
      left = std::max(left, -moved.x());
      top = std::max(top, -moved.y());
      right = std::max(right, moved.x());
      bottom = std::max(bottom, moved.y());
    }
  }
  const auto reach = [&](double outside) { return static_cast<int>(std::min(std::ceil(outside), 1e6)) + margin; };
  return {reach(left), reach(top), size.width - reach(right), size.height - reach(bottom)};
}

}  // namespace malus
