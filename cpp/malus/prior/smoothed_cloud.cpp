#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "malus/core/cell_values_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/core/tiled_axis_internal.h"
#include "malus/prior/smoothed_cloud_internal.h"

namespace malus {
namespace {

/// Subtracts a surface's height and slope from a point.
void lower(ViewPoint& point, double height, const Eigen::Vector2d& slope) {
  point.height -= static_cast<float>(height);
  point.slope_u -= static_cast<float>(slope.x());
  point.slope_v -= static_cast<float>(slope.y());
}

/// Mean square of a standard normal variable under the weights of SmoothingSpline::reweight(1).
constexpr double weighted_gaussian_variance = 0.5808;

struct SplineFit {
  SmoothingSpline spline;
  Image<float> variance;  ///< for unit noise, per cell
  double noise2;          ///< variance of a point
};

/// Robust smoothing of the points in a box.
SplineFit fit_robust(const Mask& mask, PixelRect box, const CloudSmoothing& how, std::span<const ViewPoint> points,
                     int samples, const Context& context) {
  // The weights of clustered outliers fall slowly: repeat until the weights no longer change.
  constexpr int max_rounds = 8;
  constexpr double settled = 0.004;
  SmoothingSpline spline(mask, box, how.cell_px, how.tension_px, points, context);
  for (int round = 0; round < max_rounds; ++round) {
    spline.solve(how.strength.lambda, how.strength.kappa);
    Residuals residuals;
    spline.append_residuals(residuals);
    if (!spline.reweight(robust_spread(residuals, context), settled, how.keep_raised)) break;
    spline.soften_edges(how.edge_tolerance);
    if (round + 1 == max_rounds) spline.solve(how.strength.lambda, how.strength.kappa);
  }
  const double data = spline.weight_sum() + 2 * spline.slope_weight_sum();
  const double noise2 = spline.penalized_residual() / std::max(data - 3, 1.0) / weighted_gaussian_variance;
  Image<float> variance = spline.variance(samples, context.seed);
  return {std::move(spline), std::move(variance), std::max(noise2, 0.0)};
}

/// Adds weight(u, v) times the spline and its variance for unit noise to a surface.
template <class Weight>
void add_to(SmoothedCloud& surface, const SplineFit& fit, const Mask& mask, const Context& context, Weight&& weight) {
  const PixelRect& box = fit.spline.box();
  const Image<float>& variance = fit.variance;
  parallel_rows(context, box.height(), [&](int row) {
    const int v = box.v0 + row;
    std::vector<float> heights(static_cast<std::size_t>(box.width()));
    fit.spline.evaluate_row(v, heights.data());
    const int cell_row = std::min(static_cast<int>((row + 0.5) / fit.spline.cell_px()), variance.height() - 1);
    for (int u = box.u0; u < box.u1; ++u) {
      if (mask(u, v) == 0) continue;
      const int column = std::min(static_cast<int>((u - box.u0 + 0.5) / fit.spline.cell_px()), variance.width() - 1);
      const float share = static_cast<float>(weight(u, v));
      surface.height(u, v) += share * heights[static_cast<std::size_t>(u - box.u0)];
      surface.variance(u, v) += share * variance(column, cell_row);
    }
  });
}

}  // namespace

ReferencePlane::ReferencePlane(std::span<const ViewPoint> points) {
  constexpr std::size_t most = 50'000;
  const std::size_t stride = points.size() / most + 1, count = (points.size() + stride - 1) / stride;
  std::vector<double> weights(count, 1.0), residuals(count);
  for (int round = 0; round < 8; ++round) {
    Eigen::Matrix3d normal = 1e-9 * Eigen::Matrix3d::Identity();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < count; ++i) {
      const ViewPoint& point = points[i * stride];
      const Eigen::Vector3d row(1, point.u, point.v);
      normal += weights[i] * row * row.transpose();
      right += weights[i] * point.height * row;
    }
    plane_ = normal.ldlt().solve(right);
    const auto residual = [&](std::size_t i) {
      const ViewPoint& point = points[i * stride];
      return point.height - at(point.u, point.v);
    };
    for (std::size_t i = 0; i < count; ++i) residuals[i] = std::abs(residual(i));
    const double spread = robust_spread(residuals);
    if (!(spread > 0)) break;  // most points lie exactly in the plane, as those of a plane parallel to the sensor
    for (std::size_t i = 0; i < count; ++i) {
      const double r = residual(i) / (2 * spread);
      weights[i] = 1 / (1 + r * r);
    }
  }
}
void ReferencePlane::subtract_from(std::span<ViewPoint> points) const {
  for (ViewPoint& point : points) lower(point, at(point.u, point.v), plane_.tail<2>());
}

SmoothedCloud smooth_cloud(LargeVector<ViewPoint> points, const Mask& mask, const CloudSmoothing& how,
                           const PriorOptions& options, const Context& context) {
  const PixelRect box = bounding_box(mask);
  SmoothedCloud surface{Image<float>(mask.size(), 1, 0.0F), Image<float>(mask.size(), 1, 0.0F), 0};
  const double unknowns = static_cast<double>(box.width()) * box.height() / (how.cell_px * how.cell_px);
  if (unknowns <= options.max_unknowns) {
    const SplineFit whole = fit_robust(mask, box, how, points, options.sigma_samples, context);
    add_to(surface, whole, mask, context, [](int, int) { return 1.0; });
    surface.noise = std::sqrt(whole.noise2);
    return surface;
  }

  // The coarse spline is much smoother than the tiles, so that nearly all bending of the surface is in the tiles.
  CloudSmoothing coarse = how;
  const double widening = std::max(4.0, std::sqrt(unknowns / options.max_unknowns));
  coarse.strength.lambda *= widening * widening;
  coarse.length_px *= widening;
  coarse.cell_px *= widening;
  {
    const SplineFit whole = fit_robust(mask, box, coarse, points, 0, context);
    for (ViewPoint& p : points) {
      const Eigen::Vector2d slope = whole.spline.evaluate_slope(p.u, p.v);
      lower(p, whole.spline.evaluate(p.u, p.v), slope);
    }
    parallel_rows(context, box.height(),
                  [&](int row) { whole.spline.evaluate_row(box.v0 + row, surface.height.row(box.v0 + row) + box.u0); });
  }
  // Far from points the tiles level out to the coarse surface, which all tiles share, so there are no seams.
  const int margin = static_cast<int>(std::ceil(4 * coarse.length_px));
  CloudSmoothing fine = how;
  fine.tension_px = margin;
  const int side = std::max(4 * margin, static_cast<int>(how.cell_px * std::sqrt(options.max_unknowns)) - 2 * margin);
  const Size cuts = cells_over(box.size(), side);
  const TiledImage tiled(box, cuts.width, cuts.height, margin);
  double noise2 = 0, counted = 0;
  const int tiles = tiled.tiles();
  std::vector<std::optional<SplineFit>> fits(static_cast<std::size_t>(std::max(context.threads, 1)));
  Context inner = context;
  inner.threads = 1;
  for (int first = 0; first < tiles; first += static_cast<int>(fits.size())) {
    context.progress("prior", 0.3 + 0.6 * first / tiles, "smoothing the cloud");
    parallel_for(context, fits.size(), 1, [&](std::size_t i, std::size_t) {
      const int tile = first + static_cast<int>(i);
      fits[i].reset();
      if (tile >= tiles) return;
      const PixelRect area = tiled.box(tile);
      const bool has_object = bounding_box(mask, area).height() > 0;
      if (has_object) fits[i] = fit_robust(mask, area, fine, points, options.sigma_samples, inner);
    });
    for (std::size_t i = 0; i < fits.size(); ++i) {
      if (!fits[i]) continue;
      const int tile = first + static_cast<int>(i);
      add_to(surface, *fits[i], mask, context, [&](int u, int v) { return tiled.weight(tile, u, v); });
      noise2 += fits[i]->noise2 * static_cast<double>(fits[i]->spline.points());
      counted += static_cast<double>(fits[i]->spline.points());
    }
  }
  surface.noise = std::sqrt(noise2 / counted);
  return surface;
}

}  // namespace malus
