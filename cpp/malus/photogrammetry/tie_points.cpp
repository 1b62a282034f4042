#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

#include "malus/core/parallel_internal.h"
#include "malus/photogrammetry/tie_points_internal.h"
#include "malus/stereo/intensity_pyramid_internal.h"

namespace malus {
namespace {

using Vector8d = Eigen::Matrix<double, 8, 1>;
using Matrix8d = Eigen::Matrix<double, 8, 8>;

constexpr int largest_level = 6;
/// Largest number of levels by which the images are coarsened if noise prevents a window from matching.
constexpr int most_coarser = 2;
constexpr int most_iterations = 20;
constexpr double converged_px = 2e-3;
/// Standard deviation of the affine shape about the one predicted by the plane, whose slope is known to a few degrees.
constexpr double shape_sigma = 0.05;
constexpr double largest_sigma_px = 0.3;
constexpr double least_sine = 0.34;
/// Windows with a lower contrast, in intensities of [0, 1], contain nothing but noise.
constexpr double least_contrast = 0.01;

/// Position of a window in an image: pixel = shape · offset + center.
struct Placement {
  Eigen::Matrix2d shape = Eigen::Matrix2d::Identity();
  Eigen::Vector2d center = Eigen::Vector2d::Zero();
};

struct Sample {
  double value = 0;
  Eigen::Vector2d gradient = Eigen::Vector2d::Zero();
};

/// Cubic convolution (Keys 1981, a = −1/2) and its derivative at x; false near the border, where it has no support.
bool sample(const Image<float>& image, const Eigen::Vector2d& x, Sample& result) {
  const int u = static_cast<int>(std::floor(x.x())), v = static_cast<int>(std::floor(x.y()));
  if (u < 1 || v < 1 || u > image.width() - 3 || v > image.height() - 3) return false;
  const auto weights = [](double t, std::array<double, 4>& value, std::array<double, 4>& slope) {
    value = {t * (t * (1 - 0.5 * t) - 0.5), 1 + t * t * (1.5 * t - 2.5), t * (0.5 + t * (2 - 1.5 * t)),
             t * t * (0.5 * t - 0.5)};
    slope = {t * (2 - 1.5 * t) - 0.5, t * (4.5 * t - 5), 0.5 + t * (4 - 4.5 * t), t * (1.5 * t - 1)};
  };
  std::array<double, 4> wx, dx, wy, dy;
  weights(x.x() - u, wx, dx);
  weights(x.y() - v, wy, dy);
  result = {};
  for (int j = 0; j < 4; ++j) {
    const float* row = image.row(v - 1 + j) + (u - 1);
    double value = 0, slope = 0;
    for (std::size_t i = 0; i < 4; ++i) {
      value += wx[i] * static_cast<double>(row[i]);
      slope += dx[i] * static_cast<double>(row[i]);
    }
    const auto k = static_cast<std::size_t>(j);
    result.value += wy[k] * value;
    result.gradient += Eigen::Vector2d(wy[k] * slope, dy[k] * value);
  }
  return std::isfinite(result.value);
}

/// The offsets of a square window, with Gaussian weights so that content entering at its border has little effect.
struct Window {
  explicit Window(int radius) {
    for (int v = -radius; v <= radius; ++v) {
      for (int u = -radius; u <= radius; ++u) {
        offsets.emplace_back(u, v);
        weights.push_back(std::exp(-2.0 * (u * u + v * v) / (radius * radius)));
      }
    }
  }
  std::vector<Eigen::Vector2d> offsets;
  std::vector<double> weights;
};

/// Intensities of the window in the reference; empty if the window leaves the image or has no contrast.
std::vector<double> reference_values(const Image<float>& image, const Eigen::Vector2d& center, const Window& window) {
  std::vector<double> values;
  values.reserve(window.offsets.size());
  double weight = 0, sum = 0, squares = 0;
  Sample at;
  for (std::size_t k = 0; k < window.offsets.size(); ++k) {
    if (!sample(image, center + window.offsets[k], at)) return {};
    values.push_back(at.value);
    weight += window.weights[k];
    sum += window.weights[k] * at.value;
    squares += window.weights[k] * at.value * at.value;
  }
  const double variance = squares / weight - sum * sum / (weight * weight);
  if (variance < least_contrast * least_contrast) return {};
  return values;
}

struct Match {
  Eigen::Vector2d pixel;
  double sigma_px = 0;
};

/// Least-squares matching of the window, starting from its predicted placement.
std::optional<Match> match(const Image<float>& image, const Placement& start, const std::vector<double>& reference,
                           const Window& window, const PhotosOptions& options, double range) {
  Placement placed = start;
  double variance = 0;
  for (int iteration = 0; iteration < most_iterations; ++iteration) {
    Matrix8d normal = Matrix8d::Zero();
    Vector8d right = Vector8d::Zero();
    double weight = 0, sum = 0, squares = 0;
    Sample at;
    for (std::size_t k = 0; k < window.offsets.size(); ++k) {
      const Eigen::Vector2d& d = window.offsets[k];
      if (!sample(image, placed.shape * d + placed.center, at)) return std::nullopt;
      // By the columns of the shape, the center, gain and offset.
      Vector8d row;
      row << at.gradient * d.x(), at.gradient * d.y(), at.gradient, -reference[k], -1;
      const double w = window.weights[k];
      normal.selfadjointView<Eigen::Lower>().rankUpdate(row, w);
      right -= w * at.value * row;
      weight += w;
      sum += w * at.value;
      squares += w * at.value * at.value;
    }
    normal = Matrix8d(normal.selfadjointView<Eigen::Lower>());
    const double contrast = squares / weight - sum * sum / (weight * weight);
    if (contrast < least_contrast * least_contrast) return std::nullopt;
    // Before the first solution the residuals are unknown: assume those of a poor match, a tenth of the contrast.
    const double noise = iteration == 0 ? 0.1 * contrast : variance;
    const double tie = noise / (shape_sigma * shape_sigma);
    const Eigen::Matrix2d bent = placed.shape - start.shape;
    Matrix8d tied = normal;
    tied.diagonal().head<4>().array() += tie;
    Vector8d tied_right = right;
    tied_right.head<4>() -= tie * Eigen::Map<const Eigen::Vector4d>(bent.data());
    const Eigen::LDLT<Matrix8d> factor(tied);
    if (factor.info() != Eigen::Success || !factor.isPositive()) return std::nullopt;
    const Vector8d step = factor.solve(tied_right);
    // Σ w (value + row · step)², with the residuals that the solution predicts.
    variance = std::max(squares + step.dot(normal * step) - 2 * right.dot(step), 0.0) / weight;
    const Eigen::Vector2d shift = step.segment<2>(4);
    placed.shape += Eigen::Map<const Eigen::Matrix2d>(step.data());
    placed.center += shift;
    if (!((placed.center - start.center).norm() <= range)) return std::nullopt;
    if (shift.norm() > converged_px || iteration == 0) continue;

    if (step(6) <= 0) return std::nullopt;
    const double correlation = std::sqrt(std::max(1 - variance / contrast, 0.0));
    if (correlation < options.match_min_correlation) return std::nullopt;
    const Matrix8d covariance = std::max(variance, 1e-12) * factor.solve(Matrix8d::Identity());
    return Match{placed.center, std::sqrt(0.5 * (covariance(4, 4) + covariance(5, 5)))};
  }
  return std::nullopt;
}

class Matcher {
 public:
  Matcher(std::span<const SweepView> views, const PhotosOptions& options, const Context& context)
      : views_(views), options_(options), window_(options.match_radius), wide_(2 * options.match_radius) {
    for (const SweepView& view : views) {
      std::vector<Image<float>>& reduced = reduced_.emplace_back();
      for (int side = std::min(view.intensity.width(), view.intensity.height());
           static_cast<int>(reduced.size()) < largest_level && side >= 8 * options.match_radius; side /= 2) {
        reduced.push_back(halved(reduced.empty() ? view.intensity : reduced.back(), context));
      }
    }
  }

  std::vector<TieObservation> operator()(std::size_t index, const TiePoint& point) const {
    const SweepView& reference = views_[point.reference];
    const auto seen = project(reference, point.position);
    if (!seen) return {};
    const Eigen::Vector2d pixel(std::round(seen->x()), std::round(seen->y()));
    const auto center = meet(reference, pixel, point);
    if (!center) return {};
    // Reference windows by pyramid level and window width, sampled when needed.
    std::array<std::optional<std::vector<double>>, 2 * (largest_level + 1)> patches;
    std::vector<TieObservation> found{{index, point.reference, pixel, 0}};
    for (std::size_t view = 0; view < views_.size(); ++view) {
      if (view == point.reference) continue;
      const auto expected = expect(point, *center, pixel, view);
      if (!expected) continue;
      const double scale = std::sqrt(std::abs(expected->shape.determinant()));
      for (int coarser = 0; coarser <= most_coarser; ++coarser) {
        const int level = level_of(scale, coarser), reference_level = level_of(1 / scale, coarser);
        if (level > coarsest(view) || reference_level > coarsest(point.reference)) break;
        const Window& window = coarser == 0 ? window_ : wide_;
        auto& patch = patches[2 * static_cast<std::size_t>(reference_level) + (coarser == 0 ? 0 : 1)];
        if (!patch) {
          patch =
              reference_values(at_level(point.reference, reference_level), pixel / std::exp2(reference_level), window);
        }
        if (patch->empty()) continue;
        const double reduction = std::exp2(level);
        const Placement start{expected->shape * (std::exp2(reference_level) / reduction), expected->center / reduction};
        const auto matched =
            match(at_level(view, level), start, *patch, window, options_, options_.match_range_px / reduction);
        if (!matched) continue;
        const double sigma = std::hypot(reduction * matched->sigma_px, options_.match_floor_px);
        if (sigma <= largest_sigma_px) found.push_back({index, view, reduction * matched->pixel, sigma});
        break;
      }
    }
    if (found.size() < 2) found.clear();
    return found;
  }

 private:
  int coarsest(std::size_t view) const { return static_cast<int>(reduced_[view].size()); }
  const Image<float>& at_level(std::size_t view, int level) const {
    return level == 0 ? views_[view].intensity : reduced_[view][static_cast<std::size_t>(level - 1)];
  }

  /// Pyramid level at which an image `scale` times as fine as the other has about the other's resolution, plus
  /// `coarser` levels.
  static int level_of(double scale, int coarser) {
    return std::clamp(static_cast<int>(std::floor(std::log2(std::max(scale, 1.0)) + 0.5)) + coarser, 0, largest_level);
  }

  static std::optional<Eigen::Vector2d> project(const SweepView& view, const Eigen::Vector3d& point) {
    const Eigen::Vector3d x = view.pose.cam_from_world(point);
    if (!(x.z() > 0)) return std::nullopt;
    const Eigen::Vector2d ideal(x.x() / x.z(), x.y() / x.z());
    const Eigen::Vector2d pixel = view.camera.distort(ideal);
    // Far outside the image a lens polynomial may fold back into it.
    const Pinhole raster = view.camera.pinhole();
    const double limit = 0.75 * std::hypot(view.camera.size.width, view.camera.size.height) / raster.focal();
    if (!(ideal.norm() <
          limit + std::hypot(raster.cx - 0.5 * view.camera.size.width, raster.cy - 0.5 * view.camera.size.height) /
                      raster.focal())) {
      return std::nullopt;
    }
    if (!(pixel.x() >= 0 && pixel.y() >= 0 && pixel.x() <= view.camera.size.width - 1 &&
          pixel.y() <= view.camera.size.height - 1)) {
      return std::nullopt;
    }
    return pixel;
  }

  /// Where a pixel's ray meets the point's plane.
  static std::optional<Eigen::Vector3d> meet(const SweepView& view, const Eigen::Vector2d& pixel,
                                             const TiePoint& point) {
    const Eigen::Vector3d origin = view.pose.center();
    const Eigen::Vector3d ray =
        (view.pose.rotation.transpose() * view.camera.undistort(pixel).homogeneous()).normalized();
    const double along = ray.dot(point.normal);
    if (std::abs(along) < least_sine) return std::nullopt;
    const double distance = (point.position - origin).dot(point.normal) / along;
    if (!(distance > 0)) return std::nullopt;
    return origin + distance * ray;
  }

  /// Where the plane puts the reference's window in a view.
  std::optional<Placement> expect(const TiePoint& point, const Eigen::Vector3d& center, const Eigen::Vector2d& pixel,
                                  std::size_t view) const {
    const SweepView& reference = views_[point.reference];
    const SweepView& other = views_[view];
    const Eigen::Vector3d away = other.pose.center() - center, back = reference.pose.center() - center;
    const double sine = away.normalized().dot(point.normal);
    // Both views must see the same side of the plane, at an angle that is not too flat.
    if (std::abs(sine) < least_sine || sine * back.dot(point.normal) < 0) return std::nullopt;
    const auto image = project(other, center);
    if (!image) return std::nullopt;
    Placement placed;
    placed.center = *image;
    const double reach = 0.5 * options_.match_radius;
    for (int axis = 0; axis < 2; ++axis) {
      const Eigen::Vector2d shift = reach * Eigen::Vector2d::Unit(axis);
      const auto after = meet(reference, pixel + shift, point), before = meet(reference, pixel - shift, point);
      if (!after || !before) return std::nullopt;
      const auto high = project(other, *after), low = project(other, *before);
      if (!high || !low) return std::nullopt;
      placed.shape.col(axis) = (*high - *low) / (2 * reach);
    }
    return placed;
  }

  std::span<const SweepView> views_;
  const PhotosOptions& options_;
  Window window_, wide_;
  std::vector<std::vector<Image<float>>> reduced_;  ///< pyramid levels of each view, without the first
};

}  // namespace

std::vector<TieObservation> match_tie_points(std::span<const SweepView> views, std::span<const TiePoint> points,
                                             const PhotosOptions& options, const Context& context) {
  const Matcher matcher(views, options, context);
  std::vector<std::vector<TieObservation>> found(points.size());
  parallel_for(context, points.size(), 16, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) found[k] = matcher(k, points[k]);
  });
  std::vector<TieObservation> all;
  for (const auto& of_point : found) all.insert(all.end(), of_point.begin(), of_point.end());
  return all;
}

}  // namespace malus
