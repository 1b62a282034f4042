#include "malus/prior/choose_smoothing.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "malus/core/parallel.h"

namespace malus {
namespace {

/// Windows are squares of this many cells a side, and at most this many.
constexpr int window_cells = 100;
constexpr std::size_t max_windows = 6;

/// The windows with points spread over the box: every k-th of those that hold at least half as many as is usual.
std::vector<PixelBox> pick_windows(PixelBox box, std::span<const ViewPoint> points, double side_px) {
  const int columns = std::max(1, static_cast<int>(std::round(box.width() / side_px)));
  const int rows = std::max(1, static_cast<int>(std::round(box.height() / side_px)));
  std::vector<PixelBox> windows;
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      windows.push_back({box.u0 + box.width() * column / columns, box.v0 + box.height() * row / rows,
                         box.u0 + box.width() * (column + 1) / columns, box.v0 + box.height() * (row + 1) / rows});
    }
  }
  std::vector<std::size_t> counts(windows.size(), 0);
  for (const ViewPoint& p : points) {
    const auto in_box = [](double x, int extent, int parts) {
      return static_cast<std::size_t>(std::clamp(static_cast<int>((x + 0.5) * parts / extent), 0, parts - 1));
    };
    ++counts[in_box(p.v - box.v0, box.height(), rows) * static_cast<std::size_t>(columns) +
             in_box(p.u - box.u0, box.width(), columns)];
  }
  const std::size_t usual = points.size() / windows.size();
  std::vector<PixelBox> good;
  for (std::size_t i = 0; i < windows.size(); ++i) {
    if (2 * counts[i] >= usual && counts[i] > 0) good.push_back(windows[i]);
  }
  std::vector<PixelBox> picked;
  const std::size_t count = std::min(good.size(), max_windows);
  for (std::size_t i = 0; i < count; ++i) picked.push_back(good[(2 * i + 1) * good.size() / (2 * count)]);
  return picked;
}

class Windows {
 public:
  Windows(const Mask& mask, PixelBox box, std::span<const ViewPoint> points, double spacing_px,
          const Context& context) {
    const double cell_px = std::max(1.0, 0.6 * spacing_px);
    for (const PixelBox& window : pick_windows(box, points, window_cells * cell_px)) {
      splines_.emplace_back(mask, window, cell_px, 1e3 * spacing_px, points, context);
    }
  }

  /// Robust weights at this smoothing.
  void reweight(double lambda, int rounds, const Context& context) {
    for (int round = 0; round < rounds; ++round) {
      solve(lambda, context);
      std::vector<double> residuals;
      for (const SmoothingSpline& spline : splines_) spline.append_residuals(residuals);
      const double spread = std::max(min_spread_gsd, robust_spread(residuals));
      for (SmoothingSpline& spline : splines_) spline.reweight(spread);
    }
  }

  /// −2 × restricted log likelihood, up to a constant.
  double criterion(double lambda, const Context& context) {
    solve(lambda, context);
    double weight = 0, residual = 0, determinant = 0;
    for (const SmoothingSpline& spline : splines_) {
      weight += spline.weight_sum() - 3;
      residual += spline.penalized_residual();
      determinant += spline.log_determinant() - 2 * std::log(lambda) * (static_cast<double>(spline.unknowns()) - 3);
    }
    return weight * std::log(std::max(residual, 1e-30)) + determinant;
  }

 private:
  void solve(double lambda, const Context& context) {
    parallel_for(context, splines_.size(), 1, [&](std::size_t i, std::size_t) { splines_[i].solve(lambda); });
  }

  std::vector<SmoothingSpline> splines_;
};

/// Minimum over ln λ by steps of `step` downhill from a start, then a parabola through the last three.
double minimize(Windows& windows, double start, double step, double low, double high, const Context& context) {
  double x = start;
  double left = windows.criterion(std::exp(x - step), context), centre = windows.criterion(std::exp(x), context),
         right = windows.criterion(std::exp(x + step), context);
  while (left < centre && x - step > low) {
    x -= step, right = centre, centre = left;
    left = windows.criterion(std::exp(x - step), context);
  }
  while (right < centre && x + step < high) {
    x += step, left = centre, centre = right;
    right = windows.criterion(std::exp(x + step), context);
  }
  const double curvature = left - 2 * centre + right;
  return curvature > 0 ? x + std::clamp(0.5 * (left - right) / curvature, -1.0, 1.0) * step : x;
}

}  // namespace

double robust_spread(std::vector<double>& absolute_residuals) {
  if (absolute_residuals.empty()) return 0;
  const auto middle = absolute_residuals.begin() + static_cast<std::ptrdiff_t>(absolute_residuals.size() / 2);
  std::nth_element(absolute_residuals.begin(), middle, absolute_residuals.end());
  return 1.4826 * *middle;
}

double choose_smoothing(const Mask& mask, PixelBox box, std::span<const ViewPoint> points, double spacing_px,
                        const Context& context) {
  Windows windows(mask, box, points, spacing_px, context);
  // λ that smooths over `lengths` spacings.
  const auto log_lambda = [spacing_px](double lengths) { return 2 * std::log(lengths) + std::log(spacing_px); };
  double x = log_lambda(1.5);
  for (int round = 0; round < 2; ++round) {
    windows.reweight(std::exp(x), 4, context);
    x = minimize(windows, x, round == 0 ? 0.7 : 0.35, log_lambda(0.2), log_lambda(10), context);
  }
  return std::exp(x);
}

}  // namespace malus
