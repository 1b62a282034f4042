#include <algorithm>
#include <cmath>

#include "malus/stereo/match_rows_internal.h"
#include "malus/stereo/tile_matcher_internal.h"

namespace malus {
namespace {

/// Window sums of a padded raster.
std::vector<float> window_sums(int radius, const std::vector<float>& padded, std::size_t stride, std::size_t rows) {
  const std::size_t window = 2 * static_cast<std::size_t>(radius) + 1;
  const std::size_t width = stride + 1 - window, height = rows + 1 - window;
  std::vector<float> lines(width * rows, 0.0F), sums(width * height, 0.0F);
  for (std::size_t v = 0; v < rows; ++v) {
    for (std::size_t k = 0; k < window; ++k) {
      for (std::size_t u = 0; u < width; ++u) lines[v * width + u] += padded[v * stride + u + k];
    }
  }
  for (std::size_t v = 0; v < height; ++v) {
    for (std::size_t k = 0; k < window; ++k) {
      for (std::size_t u = 0; u < width; ++u) sums[v * width + u] += lines[(v + k) * width + u];
    }
  }
  return sums;
}

}  // namespace

TileMatcher::TileMatcher(const MatchLevel& level, PixelRect tile, const Surface& log_depth,
                         const MatchSettings& settings)
    : tile_(tile),
      padded_{tile.u0 - settings.radius, tile.v0 - settings.radius, tile.u1 + settings.radius,
              tile.v1 + settings.radius},
      settings_(settings),
      reduction_(level.reduction),
      stride_(static_cast<std::size_t>(padded_.width())),
      rows_(static_cast<std::size_t>(padded_.height())) {
  take_reference(level, log_depth);
  choose_views(level);
}

void TileMatcher::take_reference(const MatchLevel& level, const Surface& log_depth) {
  const std::size_t n = stride_ * rows_;
  depth_.assign(n, 0.0F);
  weight_.assign(n, 0.0F);
  weighted_.assign(n, 0.0F);
  double sum = 0;
  std::size_t object = 0;
  for_each_pixel(tile_.grown(settings_.radius, level.mask.size()), level.mask, [&](int u, int v) {
    const float depth = log_depth(u, v);
    if (!std::isfinite(depth)) return;
    const std::size_t i = padded_.size().index(u - padded_.u0, v - padded_.v0);
    depth_[i] = std::exp(depth);
    weight_[i] = 1.0F;
    weighted_[i] = level.reference(u, v);
    sum += depth_[i];
    ++object;
  });
  const float mean_depth = object > 0 ? static_cast<float>(sum / static_cast<double>(object)) : 1.0F;
  std::vector<float> squared(n);
  for (std::size_t i = 0; i < n; ++i) {
    if (weight_[i] == 0) depth_[i] = mean_depth;
    squared[i] = weighted_[i] * weighted_[i];
  }
  inverse_count_ = window_sums(settings_.radius, weight_, stride_, rows_);
  mean_ = window_sums(settings_.radius, weighted_, stride_, rows_);
  inverse_deviation_ = window_sums(settings_.radius, squared, stride_, rows_);
  for (std::size_t i = 0; i < inverse_count_.size(); ++i) {
    inverse_count_[i] = 1.0F / std::max(inverse_count_[i], 1.0F);
    mean_[i] *= inverse_count_[i];
    const float variance = std::max(0.0F, inverse_deviation_[i] * inverse_count_[i] - mean_[i] * mean_[i]);
    inverse_deviation_[i] = 1.0F / std::sqrt(variance + settings_.noise_variance);
  }
}

void TileMatcher::project(const View& view, float offset, std::vector<float>& x, std::vector<float>& y) const {
  const float factor = std::exp(offset), scale = view.view->scale;
  std::vector<float> depth(stride_);
  for (std::size_t v = 0; v < rows_; ++v) {
    for (std::size_t u = 0; u < stride_; ++u) depth[u] = depth_[v * stride_ + u] * factor;
    // Pixels of the level are `reduction` pixels of the station's image apart.
    view.view->projection->project_row(padded_.u0, padded_.v0 + static_cast<double>(v), reduction_, depth.data(),
                                       stride_, &x[v * stride_], &y[v * stride_]);
  }
  for (float& value : x) value *= scale;
  for (float& value : y) value *= scale;
}

void TileMatcher::choose_views(const MatchLevel& level) {
  constexpr float margin = 2;
  const std::size_t n = stride_ * rows_, width = static_cast<std::size_t>(tile_.width());
  const auto radius = static_cast<std::size_t>(settings_.radius);
  std::vector<std::pair<double, std::size_t>> ranking;
  for (const MatchView& candidate : level.views) {
    View view{&candidate, std::vector<float>(tile_pixels(), 0.0F), {}};
    std::vector<float> x(n), y(n);
    project(view, 0, x, y);
    const float max_x = static_cast<float>(candidate.photo->size().width - 1) - margin;
    const float max_y = static_cast<float>(candidate.photo->size().height - 1) - margin;
    double pixels = 0;
    for (std::size_t i = 0; i < view.seen.size(); ++i) {
      const std::size_t k = (i / width + radius) * stride_ + i % width + radius;
      const bool inside = x[k] >= margin && y[k] >= margin && x[k] <= max_x && y[k] <= max_y;
      view.seen[i] = inside && weight_[k] != 0 ? 1.0F : 0.0F;
      pixels += view.seen[i];
    }
    if (pixels == 0) continue;
    view.path[0] = std::move(x);
    view.path[3] = std::move(y);
    ranking.emplace_back(-pixels * candidate.quality, views_.size());
    views_.push_back(std::move(view));
  }
  if (views_.size() > static_cast<std::size_t>(settings_.max_views)) {
    std::sort(ranking.begin(), ranking.end());
    ranking.resize(static_cast<std::size_t>(settings_.max_views));
    std::vector<View> chosen;
    for (const auto& [rank, index] : ranking) chosen.push_back(std::move(views_[index]));
    views_ = std::move(chosen);
  }
  count_.assign(tile_pixels(), 0.0F);
  half_count_.fill(count_);
  for (View& view : views_) {
    for (const std::size_t k : {1, 2, 4, 5}) view.path[k].resize(n);
    auto& half = half_count_[static_cast<std::size_t>(view.view->subset)];
    for (std::size_t i = 0; i < count_.size(); ++i) {
      count_[i] += view.seen[i];
      half[i] += view.seen[i];
    }
  }
}

void TileMatcher::prepare(float center, float half_range) {
  center_ = center;
  half_range_ = half_range;
  const std::size_t n = stride_ * rows_;
  std::vector<float> near_x(n), near_y(n), far_x(n), far_y(n);
  for (View& view : views_) {
    auto& path = view.path;
    project(view, center - half_range, near_x, near_y);
    if (center != projected_) project(view, center, path[0], path[3]);
    project(view, center + half_range, far_x, far_y);
    for (std::size_t i = 0; i < n; ++i) {
      path[1][i] = 0.5F * (far_x[i] - near_x[i]);
      path[2][i] = 0.5F * (far_x[i] + near_x[i]) - path[0][i];
      path[4][i] = 0.5F * (far_y[i] - near_y[i]);
      path[5][i] = 0.5F * (far_y[i] + near_y[i]) - path[3][i];
    }
  }
  projected_ = center;
}

void TileMatcher::score(float offset, Scores& scores) const {
  const float t = (offset - center_) / half_range_;
  const auto width = static_cast<std::size_t>(tile_.width()),
             window = rows_ + 1 - static_cast<std::size_t>(tile_.height());
  const auto best = static_cast<std::size_t>(settings_.best), half_best = (best + 1) / 2;
  scores.all.resize(tile_pixels());
  if (settings_.compare_halves) {
    for (auto& half : scores.half) half.resize(tile_pixels());
  }
  // All views are processed for a row before the next row. This keeps in the cache what is needed to choose each
  // pixel's best views: the window lines of every view, and the row's best values.
  const std::size_t ring = 3 * width * window;
  scores.lines.resize(ring * views_.size());
  std::vector<float> warped(stride_), scratch(stride_), totals(3 * width), found(width), copy(width);
  std::vector<float> lists((best + 2 * half_best) * width);
  float* const all = lists.data();
  const std::array<float*, 2> half{all + best * width, all + (best + half_best) * width};
  for (std::size_t v = 0; v < rows_; ++v) {
    const std::size_t row = v * stride_;
    const bool complete = v + 1 >= window;
    const std::size_t out = complete ? (v + 1 - window) * width : 0;
    std::fill(lists.begin(), lists.end(), 0.0F);
    for (std::size_t k = 0; k < views_.size(); ++k) {
      const View& view = views_[k];
      PathRow path;
      for (std::size_t i = 0; i < path.size(); ++i) path[i] = &view.path[i][row];
      sample_row(*view.view->photo, path, t, stride_, warped.data());
      float* const lines = &scores.lines[ring * k];
      window_lines(warped.data(), &weight_[row], &weighted_[row], width, window, scratch.data(),
                   lines + 3 * width * (v % window));
      if (!complete) continue;
      correlate_row(lines, window, width, {&inverse_count_[out], &mean_[out], &inverse_deviation_[out]},
                    &view.seen[out], settings_.noise_variance, totals.data(), found.data());
      if (settings_.compare_halves) {
        copy = found;
        insert_row(copy.data(), width, half_best, half[static_cast<std::size_t>(view.view->subset)]);
      }
      insert_row(found.data(), width, best, all);
    }
    if (!complete) continue;
    mean_row(all, width, best, &count_[out], &scores.all[out]);
    if (!settings_.compare_halves) continue;
    for (std::size_t k = 0; k < 2; ++k) mean_row(half[k], width, half_best, &half_count_[k][out], &scores.half[k][out]);
  }
}

}  // namespace malus
