#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "malus/core/geometry.h"
#include "malus/io/input_file_internal.h"
#include "malus/io/point_columns_internal.h"

namespace malus {

/// Collects points; finds coordinates that are not finite.
class CloudBuilder {
 public:
  /// `color_scale`: factor from colors to bytes; nothing if only all colors together show it.
  CloudBuilder(const PointColumns& columns, std::optional<double> color_scale)
      : has_normals_(columns.has_three(slot_nx)), has_colors_(columns.has_three(slot_red)), color_scale_(color_scale) {}

  void reserve(std::size_t count) {
    cloud_.points.reserve(count);
    if (has_normals_) cloud_.normals.reserve(count);
    if (has_colors_) cloud_.colors.reserve(count);
  }

  void add(const PointValues& values) {
    const Eigen::Vector3d point(values[slot_x], values[slot_y], values[slot_z]);
    if (!point.allFinite() && bad_++ == 0) first_bad_ = cloud_.points.size();
    cloud_.points.push_back(point);
    if (has_normals_) {
      const Eigen::Vector3d normal(values[slot_nx], values[slot_ny], values[slot_nz]);
      cloud_.normals.push_back(normal.allFinite() ? Eigen::Vector3f(normal.cast<float>()) : Eigen::Vector3f::Zero());
    }
    if (!has_colors_) return;
    const Eigen::Vector3d color(values[slot_red], values[slot_green], values[slot_blue]);
    if (color_scale_) {
      cloud_.colors.push_back(rgb(color * *color_scale_));
    } else {
      unscaled_.push_back(color.allFinite() ? Eigen::Vector3f(color.cast<float>()) : Eigen::Vector3f::Zero());
    }
  }

  /// The points, after all were added. Throws an input error if there are none, or if coordinates are not finite.
  /// `are_named`: whether the file names the columns; otherwise those taken for colors may be normals.
  PointCloud finish(const InputFile& file, bool are_named = true);

 private:
  /// Six columns have one of both, nine have both, in either order.
  void tell_normals_from_colors();

  static Rgb rgb(const Eigen::Vector3d& color) {
    const auto byte = [](double value) {
      const double rounded = std::round(value);
      return static_cast<std::uint8_t>(rounded >= 255 ? 255 : rounded > 0 ? rounded : 0);
    };
    return {byte(color.x()), byte(color.y()), byte(color.z())};
  }

  PointCloud cloud_;
  std::vector<Eigen::Vector3f> unscaled_;  ///< colors whose scale is not known yet
  bool has_normals_, has_colors_;
  std::optional<double> color_scale_;
  std::size_t bad_ = 0, first_bad_ = 0;
};

}  // namespace malus
