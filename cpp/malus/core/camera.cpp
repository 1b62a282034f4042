#include "malus/core/camera.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <span>

#include "malus/core/pixel_rect_internal.h"

namespace malus {
namespace {

struct Model {
  LensModel model;
  std::string_view name;
  int parameters;
  int undistorted;  ///< number of those that do not describe distortion; they come first
};

constexpr std::array<Model, 7> models{{{LensModel::simple_pinhole, "SIMPLE_PINHOLE", 3, 3},
                                       {LensModel::pinhole, "PINHOLE", 4, 4},
                                       {LensModel::simple_radial, "SIMPLE_RADIAL", 4, 3},
                                       {LensModel::radial, "RADIAL", 5, 3},
                                       {LensModel::opencv, "OPENCV", 8, 4},
                                       {LensModel::full_opencv, "FULL_OPENCV", 12, 4},
                                       {LensModel::brown, "BROWN", 10, 4}}};

const Model& entry(LensModel model) {
  return models[static_cast<std::size_t>(model)];
}

/// OpenCV's ideal → measured model in normalized coordinates; the simpler models have zeros here.
struct OpenCvDistortion {
  double k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0, k4 = 0, k5 = 0, k6 = 0;

  Eigen::Vector2d operator()(const Eigen::Vector2d& ideal) const {
    const double x = ideal.x(), y = ideal.y(), r2 = x * x + y * y;
    const double radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)));
    return {x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y};
  }
};

OpenCvDistortion opencv_distortion(const LensCamera& camera) {
  const auto& p = camera.params;
  switch (camera.model) {
    case LensModel::simple_radial:
      return {.k1 = p[3]};
    case LensModel::radial:
      return {.k1 = p[3], .k2 = p[4]};
    case LensModel::opencv:
      return {.k1 = p[4], .k2 = p[5], .p1 = p[6], .p2 = p[7]};
    case LensModel::full_opencv:
      return {p[4], p[5], p[6], p[7], p[8], p[9], p[10], p[11]};
    default:
      return {};
  }
}

/// Brown's measured → ideal correction (Eq 13), image coordinates in mm relative to the principal point, y up.
Eigen::Vector2d brown_correction(const std::vector<double>& p, const Eigen::Vector2d& measured) {
  const double k1 = p[4], k2 = p[5], k3 = p[6], p1 = p[7], p2 = p[8], p3 = p[9];
  const double x = measured.x(), y = measured.y(), r2 = x * x + y * y;
  const double radial = r2 * (k1 + r2 * (k2 + r2 * k3)), tangential = 1 + p3 * r2;
  return {x + x * radial + (p1 * (r2 + 2 * x * x) + 2 * p2 * x * y) * tangential,
          y + y * radial + (p2 * (r2 + 2 * y * y) + 2 * p1 * x * y) * tangential};
}

/// Derivatives of a map, by central differences.
template <class Forward>
Eigen::Matrix2d jacobian_of(const Forward& forward, const Eigen::Vector2d& at, double step) {
  Eigen::Matrix2d jacobian;
  for (int axis = 0; axis < 2; ++axis) {
    const Eigen::Vector2d shift = step * Eigen::Vector2d::Unit(axis);
    jacobian.col(axis) = (forward(at + shift) - forward(at - shift)) / (2 * step);
  }
  return jacobian;
}

/// Solves forward(x) = target by Newton's method, from x = start.
template <class Forward>
Eigen::Vector2d invert(const Forward& forward, const Eigen::Vector2d& target, Eigen::Vector2d start, double step) {
  for (int iteration = 0; iteration < 30; ++iteration) {
    const Eigen::Vector2d update = jacobian_of(forward, start, step).inverse() * (forward(start) - target);
    start -= update;
    if (update.norm() < 1e-12 * (1 + start.norm())) break;
  }
  return start;
}

/// Whether a lens sends the ideal point to the measured one, and does not bend back on the way from the center to it:
/// far out its polynomials do, and Newton's method may end at a point behind, or on the other side of the center.
template <class Forward>
bool is_inverse(const Forward& forward, const Eigen::Vector2d& measured, const Eigen::Vector2d& ideal, double step) {
  constexpr double solved = 1e-9, little = 0.25;
  constexpr int steps = 8;
  if (!((forward(ideal) - measured).norm() < solved * (1 + measured.norm()))) return false;
  if ((ideal - measured).norm() < little * measured.norm()) return true;
  for (int i = 1; i <= steps; ++i) {
    if (!(jacobian_of(forward, ideal * (static_cast<double>(i) / steps), step).determinant() > 0)) return false;
  }
  return true;
}

}  // namespace

Pinhole Pinhole::cropped(const PixelRect& rect) const {
  return {rect.size(), fx, fy, cx - rect.u0, cy - rect.v0};
}

std::string_view to_string(LensModel model) {
  return entry(model).name;
}

int parameter_count(LensModel model) {
  return entry(model).parameters;
}

int principal_point_index(LensModel model) {
  return entry(model).undistorted - 2;
}

LensModel lens_model(std::string_view name, const std::string& where) {
  std::string names;
  for (const Model& candidate : models) {
    if (candidate.name == name) return candidate.model;
    names += (names.empty() ? "" : ", ") + std::string(candidate.name);
  }
  throw input_error(where + " = \"" + std::string(name) + "\" is not a supported camera model; expected one of " +
                    names);
}

Pinhole LensCamera::pinhole() const {
  switch (model) {
    case LensModel::simple_pinhole:
    case LensModel::simple_radial:
    case LensModel::radial:
      return {size, params[0], params[0], params[1], params[2]};
    case LensModel::brown: {
      const double focal_px = params[0] / params[1];
      return {size, focal_px, focal_px, 0.5 * (size.width - 1) + params[2] / params[1],
              0.5 * (size.height - 1) - params[3] / params[1]};
    }
    default:
      return {size, params[0], params[1], params[2], params[3]};
  }
}

Eigen::Vector2d LensCamera::distort(const Eigen::Vector2d& ideal) const {
  const Pinhole k = pinhole();
  if (model == LensModel::brown) {
    const double focal_mm = params[0], pixel_mm = params[1];
    const Eigen::Vector2d target(ideal.x() * focal_mm, -ideal.y() * focal_mm);
    const Eigen::Vector2d measured =
        invert([&](const Eigen::Vector2d& x) { return brown_correction(params, x); }, target, target, 1e-4 * focal_mm);
    return {k.cx + measured.x() / pixel_mm, k.cy - measured.y() / pixel_mm};
  }
  const Eigen::Vector2d measured = opencv_distortion(*this)(ideal);
  return {k.fx * measured.x() + k.cx, k.fy * measured.y() + k.cy};
}

Eigen::Vector2d LensCamera::undistort(const Eigen::Vector2d& pixel) const {
  const Pinhole k = pinhole();
  if (model == LensModel::brown) {
    const double focal_mm = params[0], pixel_mm = params[1];
    const Eigen::Vector2d ideal =
        brown_correction(params, {(pixel.x() - k.cx) * pixel_mm, -(pixel.y() - k.cy) * pixel_mm});
    return {ideal.x() / focal_mm, -ideal.y() / focal_mm};
  }
  constexpr double step = 1e-5;
  const OpenCvDistortion lens_distortion = opencv_distortion(*this);
  const Eigen::Vector2d measured((pixel.x() - k.cx) / k.fx, (pixel.y() - k.cy) / k.fy);
  const Eigen::Vector2d ideal = invert(lens_distortion, measured, measured, step);
  if (is_inverse(lens_distortion, measured, ideal, step)) return ideal;
  return Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
}

bool LensCamera::has_distortion() const {
  const std::size_t undistorted = std::min<std::size_t>(entry(model).undistorted, params.size());
  return std::ranges::any_of(std::span(params).subspan(undistorted), [](double parameter) { return parameter != 0; });
}

void LensCamera::validate(const std::string& where) const {
  if (size.width < 1 || size.height < 1 || size.width > 65536 || size.height > 65536) {
    throw input_error(where + ": image size " + to_string(size) + ", expected 1 to 65536 pixels a side");
  }
  if (static_cast<int>(params.size()) != parameter_count(model)) {
    throw input_error(where + ": " + std::to_string(params.size()) + " parameters for camera model " +
                      std::string(to_string(model)) + ", expected " + std::to_string(parameter_count(model)));
  }
  for (const double value : params) {
    if (!std::isfinite(value)) throw input_error(where + ": camera parameters must be finite numbers");
  }
  if (model == LensModel::brown && !(params[1] > 0)) throw input_error(where + ": pixel_mm must be positive");
  const Pinhole k = pinhole();
  if (!(k.fx > 0) || !(k.fy > 0)) throw input_error(where + ": the focal length must be positive");
}

}  // namespace malus
