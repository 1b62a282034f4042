#pragma once

#include <Eigen/Core>
#include <cstddef>

#include "malus/core/camera.h"
#include "malus/core/pose.h"

namespace malus {

/// Projection of points of the station view into a photo, in single precision and without branches, for loops over
/// many pixels. The lens model is OpenCV's with k1 k2 k3 p1 p2, fitted to the camera's model on a grid over its image:
/// exact for models without a denominator, accurate to `fit_error_px` for FULL_OPENCV and BROWN.
class ViewProjection {
 public:
  ViewProjection(const Pinhole& station, const Pose& station_pose, const LensCamera& camera, const Pose& pose);

  /// Pixels x, y of the points at depth z[i] on the rays of the station's pixels spacing · (u0 + i, v). Points behind
  /// the camera or outside the photo's field of view get -1e6.
  void project_row(double u0, double v, double spacing, const float* z, std::size_t count, float* x, float* y) const;
  /// The same for one point, in double precision.
  Eigen::Vector2d project(double u, double v, double z) const;
  /// Center of the photo's camera in the station's frame.
  const Eigen::Vector3d& center_in_station() const { return center_in_station_; }
  double focal() const { return raster_.focal(); }
  /// Distance of a station point from the photo's camera along its axis.
  double depth_in_view(double u, double v, double z) const;
  double fit_error_px() const { return fit_error_px_; }

 private:
  void fit_lens(const LensCamera& camera);
  Eigen::Vector2d measured(const Eigen::Vector2d& ideal) const;

  Pinhole station_;
  Eigen::Matrix3d view_from_station_;
  Eigen::Vector3d translation_, center_in_station_;
  Pinhole raster_;                                                          ///< of the photo without distortion
  Eigen::Matrix<double, 5, 1> lens_ = Eigen::Matrix<double, 5, 1>::Zero();  ///< k1 k2 k3 p1 p2
  double max_r2_ = 0;  ///< squared ideal radius of the field of view; beyond it the polynomials may fold back
  double fit_error_px_ = 0;
};

}  // namespace malus
