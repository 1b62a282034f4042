#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>

#include "malus/core/parallel_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/core/tiled_axis_internal.h"
#include "malus/prior/choose_smoothing_internal.h"

namespace malus {
namespace {

/// Windows are squares with `window_cells` cells a side; at most `max_windows` are used.
constexpr int window_cells = 100;
constexpr std::size_t max_windows = 6;

/// Windows spread evenly over the box, chosen from those that hold at least half the average number of points.
std::vector<PixelRect> pick_windows(PixelRect box, std::span<const ViewPoint> points, double side_px) {
  const int columns = std::max(1, static_cast<int>(std::round(box.width() / side_px)));
  const int rows = std::max(1, static_cast<int>(std::round(box.height() / side_px)));
  const TiledImage windows(box, columns, rows, 0);
  std::vector<std::size_t> counts(static_cast<std::size_t>(windows.tiles()), 0);
  for (const ViewPoint& p : points) {
    const auto in_box = [](double x, int extent, int parts) {
      return static_cast<std::size_t>(std::clamp(static_cast<int>((x + 0.5) * parts / extent), 0, parts - 1));
    };
    ++counts[in_box(p.v - box.v0, box.height(), rows) * static_cast<std::size_t>(columns) +
             in_box(p.u - box.u0, box.width(), columns)];
  }
  const std::size_t usual = points.size() / counts.size();
  std::vector<PixelRect> good;
  for (std::size_t i = 0; i < counts.size(); ++i) {
    if (2 * counts[i] >= usual && counts[i] > 0) good.push_back(windows.box(static_cast<int>(i)));
  }
  std::vector<PixelRect> picked;
  const std::size_t count = std::min(good.size(), max_windows);
  for (std::size_t i = 0; i < count; ++i) picked.push_back(good[(2 * i + 1) * good.size() / (2 * count)]);
  return picked;
}

class Windows {
 public:
  Windows(const Mask& mask, PixelRect box, std::span<const ViewPoint> points, double spacing_px, bool keep_raised,
          const Context& context)
      : keep_raised_(keep_raised) {
    const double cell_px = cell_for_spacing(spacing_px);
    const std::vector<PixelRect> windows = pick_windows(box, points, window_cells * cell_px);
    splines_.resize(windows.size());
    parallel_for(context, windows.size(), 1, [&](std::size_t i, std::size_t) {
      splines_[i].emplace(mask, windows[i], cell_px, 1e3 * spacing_px, points, context);
    });
  }

  /// Updates the robust weights at this smoothing.
  void reweight(const SmoothingStrength& strength, int rounds, const Context& context) {
    for (int round = 0; round < rounds; ++round) {
      solve(strength, context);
      Residuals residuals;
      for (const auto& spline : splines_) spline->append_residuals(residuals);
      const ResidualSpread spread = robust_spread(residuals, context);
      parallel_for(context, splines_.size(), 1,
                   [&](std::size_t i, std::size_t) { splines_[i]->reweight(spread, 0, keep_raised_); });
    }
  }

  /// −2 × restricted log likelihood, up to a constant.
  double criterion(const SmoothingStrength& strength, const Context& context) {
    solve(strength, context);
    using Terms = Eigen::Vector3d;  // weight, residual, determinant
    const Terms sum = parallel_sum(context, splines_.size(), 1, Terms(0, 0, 0), [&](std::size_t i, std::size_t) {
      const SmoothingSpline& spline = *splines_[i];
      const double slopes = 2 * spline.slope_weight_sum();
      double determinant =
          spline.log_determinant() - 2 * std::log(strength.lambda) * (static_cast<double>(spline.unknowns()) - 3);
      if (slopes > 0) determinant -= 2 * std::log(strength.kappa) * slopes;
      return Terms(spline.weight_sum() + slopes - 3, spline.penalized_residual(), determinant);
    });
    return sum[0] * std::log(std::max(sum[1], 1e-30)) + sum[2];
  }

 private:
  /// Solves the windows in parallel; threads beyond their number work within a window's solution.
  void solve(const SmoothingStrength& strength, const Context& context) {
    parallel_for(context, splines_.size(), 1,
                 [&](std::size_t i, std::size_t) { splines_[i]->solve(strength.lambda, strength.kappa); });
  }

  bool keep_raised_;
  std::vector<std::optional<SmoothingSpline>> splines_;
};

/// Minimum: walks downhill from `start` in steps of `step`, then fits a parabola through the last three values.
template <class Function>
double minimize(Function&& function, double start, double step, double low, double high) {
  double x = start;
  double left = function(x - step), center = function(x), right = function(x + step);
  while (left < center && x - step > low) {
    x -= step, right = center, center = left;
    left = function(x - step);
  }
  while (right < center && x + step < high) {
    x += step, left = center, center = right;
    right = function(x + step);
  }
  const double curvature = left - 2 * center + right;
  return curvature > 0 ? x + std::clamp(0.5 * (left - right) / curvature, -1.0, 1.0) * step : x;
}

}  // namespace

double cell_for_spacing(double spacing_px) {
  return std::max(1.0, 0.6 * spacing_px);
}

ResidualSpread robust_spread(Residuals& residuals, const Context& context) {
  double spread[2];
  parallel_for(context, 2, 1, [&](std::size_t k, std::size_t) {
    spread[k] = robust_spread(k == 0 ? residuals.heights : residuals.slopes);
  });
  // The median length of a plane vector is 1.1774 standard deviations of its coordinates.
  return {std::max(min_spread_gsd, spread[0]), std::max(min_spread_rad, spread[1] / (deviation_per_median * 1.1774))};
}

SmoothingStrength choose_smoothing(const Mask& mask, PixelRect box, std::span<const ViewPoint> points,
                                   double spacing_px, bool keep_raised, const Context& context) {
  Windows windows(mask, box, points, spacing_px, keep_raised, context);
  const bool oriented = std::any_of(points.begin(), points.end(), [](const ViewPoint& p) { return p.has_slope(); });
  // ln of the λ that smooths over `lengths` spacings.
  const auto log_lambda = [spacing_px](double lengths) { return 2 * std::log(lengths) + std::log(spacing_px); };
  // Usual noise: 0.1 rad of a normal, 1 GSD of a point.
  double log_l = log_lambda(1.5), log_k = std::log(10);
  const auto strength = [&](double l, double k) { return SmoothingStrength{std::exp(l), oriented ? std::exp(k) : 0}; };
  for (int round = 0; round < 2; ++round) {
    const double step = round == 0 ? 0.7 : 0.35;
    windows.reweight(strength(log_l, log_k), 4, context);
    if (oriented) {
      log_k = minimize([&](double k) { return windows.criterion(strength(log_l, k), context); }, log_k, step,
                       std::log(0.01), std::log(1000));
    }
    log_l = minimize([&](double l) { return windows.criterion(strength(l, log_k), context); }, log_l, step,
                     log_lambda(0.2), log_lambda(10));
  }
  return strength(log_l, log_k);
}

}  // namespace malus
