#include <algorithm>
#include <cmath>
#include <span>
#include <string>
#include <utility>

#include "malus/io/cloud_builder_internal.h"

namespace malus {
namespace {

/// Factor that scales colors of a text to 0 … 255: programs write shares of 1, bytes or numbers of 16 bits.
double scale_of_colors(std::span<const Eigen::Vector3f> values) {
  float largest = 0;
  for (const Eigen::Vector3f& value : values) largest = std::max(largest, value.maxCoeff());
  return largest <= 1 ? 255 : largest <= 255 ? 1 : 255.0 / 65535;
}

/// How much three columns without names look like normals, by all lines: no color is negative, and few have length 1.
/// Zeros are black or an unknown normal, and say nothing.
enum class LikeNormals { no, unknown, by_length, by_sign };

LikeNormals like_normals(std::span<const Eigen::Vector3f> values) {
  constexpr float rounding = 0.02F;
  std::size_t known = 0, of_length_1 = 0;
  for (const Eigen::Vector3f& value : values) {
    if (value.minCoeff() < 0) return LikeNormals::by_sign;
    const float length = value.norm();
    known += length > 0;
    of_length_1 += std::abs(length - 1) < rounding;
  }
  if (known == 0) return LikeNormals::unknown;
  return 2 * of_length_1 >= known ? LikeNormals::by_length : LikeNormals::no;
}

}  // namespace

PointCloud CloudBuilder::finish(const InputFile& file, bool are_named) {
  if (bad_ > 0) {
    throw file.error(std::to_string(bad_) + " of " + std::to_string(cloud_.points.size()) +
                     " points have coordinates that are not finite (NaN or infinite), the first is number " +
                     std::to_string(first_bad_) + ", counted from 0");
  }
  if (cloud_.points.empty()) throw file.error("has no points");
  if (!are_named) tell_normals_from_colors();
  if (!unscaled_.empty()) {
    const double scale = scale_of_colors(unscaled_);
    cloud_.colors.reserve(unscaled_.size());
    for (const Eigen::Vector3f& color : unscaled_) cloud_.colors.push_back(rgb(color.cast<double>() * scale));
  }
  return std::move(cloud_);
}

void CloudBuilder::tell_normals_from_colors() {
  const LikeNormals colors = like_normals(unscaled_);
  if (has_normals_ ? colors > like_normals(cloud_.normals) : colors != LikeNormals::no)
    std::swap(cloud_.normals, unscaled_);
}

}  // namespace malus
