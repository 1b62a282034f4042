#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>
#include <vector>

#include "malus/core/image.h"

namespace malus {

struct PixelRect;

/// Camera without distortion, the camera of every raster after undistortion.
/// In pixels, memory convention: the center of the top-left pixel is (0, 0).
struct Pinhole {
  Size size;
  double fx = 1, fy = 1, cx = 0, cy = 0;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("width", self.size.width);
    visit("height", self.size.height);
    visit("fx", self.fx);
    visit("fy", self.fy);
    visit("cx", self.cx);
    visit("cy", self.cy);
  }

  /// Direction of the pixel's ray in the camera frame (x right, y down, z forward), scaled to z = 1.
  Eigen::Vector3d ray(double u, double v) const { return {(u - cx) / fx, (v - cy) / fy, 1.0}; }
  /// Pixel (u, v) of a point in the camera frame; z must be positive.
  Eigen::Vector2d project(const Eigen::Vector3d& x_in_cam) const {
    return {fx * x_in_cam.x() / x_in_cam.z() + cx, fy * x_in_cam.y() / x_in_cam.z() + cy};
  }
  /// Mean focal length in pixels; depth / focal() is the ground sampling distance (GSD).
  double focal() const { return 0.5 * (fx + fy); }
  /// Camera of a part of the raster.
  Pinhole cropped(const PixelRect& rect) const;
  /// Camera of this raster binned 2 × 2 (each new pixel is the mean of 2 × 2 pixels).
  Pinhole binned() const {
    return {{(size.width + 1) / 2, (size.height + 1) / 2}, fx / 2, fy / 2, (cx - 0.5) / 2, (cy - 0.5) / 2};
  }
};

/// Lens models with COLMAP's names and parameter order; `brown` is Eq 13 of the source paper.
enum class LensModel { simple_pinhole, pinhole, simple_radial, radial, opencv, full_opencv, brown };

/// COLMAP's name of a model ("OPENCV"); "BROWN" for `brown`.
std::string_view to_string(LensModel model);
/// Model with this name; throws an input error that lists the supported ones. `where` names file and field.
LensModel lens_model(std::string_view name, const std::string& where);
/// Number of parameters of a model.
int parameter_count(LensModel model);
/// Index of cx among the parameters of a model; cy follows. Not for `brown`.
int principal_point_index(LensModel model);

/// Camera with lens distortion.
///
/// Parameters are in COLMAP's order, but in the memory pixel convention (cx, cy are COLMAP's minus 0.5):
///   simple_pinhole f cx cy · pinhole fx fy cx cy · simple_radial f cx cy k · radial f cx cy k1 k2 ·
///   opencv fx fy cx cy k1 k2 p1 p2 · full_opencv … k1 k2 p1 p2 k3 k4 k5 k6.
/// These models map ideal to measured coordinates. `brown` (Eq 12 and 13) maps measured to ideal coordinates:
///   brown focal_mm pixel_mm x0_mm y0_mm k1 k2 k3 p1 p2 p3 — see docs/conventions.md; image center at
///   ((width-1)/2, (height-1)/2), image x to the right and image y up, in millimeters.
struct LensCamera {
  LensModel model = LensModel::pinhole;
  Size size;
  std::vector<double> params;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("model", self.model);
    visit("width", self.size.width);
    visit("height", self.size.height);
    visit("params", self.params);
  }

  /// Measured pixel (u, v) of an ideal direction (x/z, y/z) in the camera frame.
  Eigen::Vector2d distort(const Eigen::Vector2d& ideal) const;
  /// Measured pixel of a point in the camera frame; z must be positive.
  Eigen::Vector2d project(const Eigen::Vector3d& x_in_cam) const {
    return distort({x_in_cam.x() / x_in_cam.z(), x_in_cam.y() / x_in_cam.z()});
  }
  /// Ideal direction (x/z, y/z) of a measured pixel; inverts `distort` to 1e-10. NaN at pixels to which the lens sends
  /// no ray, because its polynomials bend back before.
  Eigen::Vector2d undistort(const Eigen::Vector2d& pixel) const;
  /// Camera of the undistorted raster: same size, focal length and principal point.
  Pinhole pinhole() const;
  /// Whether the model distorts at all.
  bool has_distortion() const;
  /// Throws an input error unless size and parameters are usable. `where` names file and field.
  void validate(const std::string& where) const;
};

}  // namespace malus
