#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>

#include "malus/stereo/tile_matcher_internal.h"

namespace malus {
namespace {

using Values = Eigen::Map<Eigen::ArrayXf>;
using ConstValues = Eigen::Map<const Eigen::ArrayXf>;

constexpr std::size_t chunk = 64;

/// Bilinear interpolation along x0 + t x1 + t² x2, y likewise; beyond the image its border goes on.
void sample_row(const Image<float>& image, const std::array<const float*, 6>& path, float t, std::size_t count,
                float* out) {
  // The last cell's right neighbour must exist, so the coordinates stop just short of the last pixel.
  const float max_x = static_cast<float>(image.width() - 1) - 1e-3F;
  const float max_y = static_cast<float>(image.height() - 1) - 1e-3F;
  const float t2 = t * t;
  const std::ptrdiff_t stride = image.width();
  const float* const pixels = image.data();
  std::array<float, chunk> fx, fy;
  std::array<int, chunk> cell;
  for (std::size_t begin = 0; begin < count; begin += chunk) {
    const std::size_t n = std::min(chunk, count - begin);
    for (std::size_t i = 0; i < n; ++i) {
      const std::size_t k = begin + i;
      const float x = std::min(std::max(path[0][k] + t * path[1][k] + t2 * path[2][k], 0.0F), max_x);
      const float y = std::min(std::max(path[3][k] + t * path[4][k] + t2 * path[5][k], 0.0F), max_y);
      const int column = static_cast<int>(x), row = static_cast<int>(y);
      fx[i] = x - static_cast<float>(column);
      fy[i] = y - static_cast<float>(row);
      cell[i] = row * static_cast<int>(stride) + column;
    }
    for (std::size_t i = 0; i < n; ++i) {
      const float* const p = pixels + cell[i];
      const float top = p[0] + fx[i] * (p[1] - p[0]);
      const float bottom = p[stride] + fx[i] * (p[stride + 1] - p[stride]);
      out[begin + i] = top + fy[i] * (bottom - top);
    }
  }
}

/// out[i] = sum of in[i … i + 2 radius].
template <int radius>
void horizontal_sums(const float* in, std::size_t count, float* out) {
  for (std::size_t i = 0; i < count; ++i) {
    float sum = in[i];
    for (int k = 1; k <= 2 * radius; ++k) sum += in[i + static_cast<std::size_t>(k)];
    out[i] = sum;
  }
}

/// Window sums of a padded raster.
template <int radius>
std::vector<float> window_sums(const std::vector<float>& padded, std::size_t stride, std::size_t rows) {
  const std::size_t width = stride - 2 * radius, height = rows - 2 * radius;
  std::vector<float> lines(width * rows), sums(width * height, 0.0F);
  for (std::size_t v = 0; v < rows; ++v) horizontal_sums<radius>(&padded[v * stride], width, &lines[v * width]);
  for (std::size_t v = 0; v < height; ++v) {
    for (std::size_t k = 0; k <= 2 * radius; ++k) {
      for (std::size_t u = 0; u < width; ++u) sums[v * width + u] += lines[(v + k) * width + u];
    }
  }
  return sums;
}

std::vector<float> window_sums(int radius, const std::vector<float>& padded, std::size_t stride, std::size_t rows) {
  switch (radius) {
    case 1:
      return window_sums<1>(padded, stride, rows);
    case 2:
      return window_sums<2>(padded, stride, rows);
    case 3:
      return window_sums<3>(padded, stride, rows);
    case 4:
      return window_sums<4>(padded, stride, rows);
    case 5:
      return window_sums<5>(padded, stride, rows);
    case 6:
      return window_sums<6>(padded, stride, rows);
    case 7:
      return window_sums<7>(padded, stride, rows);
    default:
      return window_sums<8>(padded, stride, rows);
  }
}

/// Puts values into lists that are sorted per pixel, largest first.
void insert(const std::vector<float>& values, std::vector<std::vector<float>>& best) {
  const std::size_t n = values.size();
  Eigen::Array<float, chunk, 1> rest;
  for (std::size_t begin = 0; begin < n; begin += chunk) {
    const auto count = static_cast<Eigen::Index>(std::min(chunk, n - begin));
    rest.head(count) = ConstValues(&values[begin], count);
    for (std::vector<float>& list : best) {
      Values kept(&list[begin], count);
      for (Eigen::Index i = 0; i + 4 <= count; i += 4) {
        const Eigen::Array4f a = kept.segment<4>(i), b = rest.segment<4>(i);
        kept.segment<4>(i) = a.max(b);
        rest.segment<4>(i) = a.min(b);
      }
      for (Eigen::Index i = count / 4 * 4; i < count; ++i) {
        const float a = kept[i], b = rest[i];
        kept[i] = std::max(a, b);
        rest[i] = std::min(a, b);
      }
    }
  }
}

void clear(std::vector<std::vector<float>>& best) {
  for (std::vector<float>& list : best) std::fill(list.begin(), list.end(), 0.0F);
}

/// Mean of the lists over min(their number, views that see the pixel).
void average(const std::vector<std::vector<float>>& best, const std::vector<float>& count, std::vector<float>& mean) {
  mean.assign(count.size(), 0.0F);
  for (const std::vector<float>& list : best) {
    for (std::size_t i = 0; i < mean.size(); ++i) mean[i] += list[i];
  }
  const auto k = static_cast<float>(best.size());
  for (std::size_t i = 0; i < mean.size(); ++i) mean[i] /= std::max(1.0F, std::min(k, count[i]));
}

}  // namespace

TileMatcher::TileMatcher(const MatchLevel& level, PixelBox tile, const Surface& log_depth,
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
  const std::size_t n = tile_pixels();
  correlation_.resize(n);
  sums_.resize(3 * static_cast<std::size_t>(tile_.width()) * static_cast<std::size_t>(2 * settings_.radius + 1));
  best_.assign(static_cast<std::size_t>(settings_.best), std::vector<float>(n));
  if (settings_.compare_halves) {
    half_best_.fill(std::vector(static_cast<std::size_t>((settings_.best + 1) / 2), std::vector<float>(n)));
  }
}

void TileMatcher::take_reference(const MatchLevel& level, const Surface& log_depth) {
  const std::size_t n = stride_ * rows_;
  depth_.assign(n, 0.0F);
  weight_.assign(n, 0.0F);
  weighted_.assign(n, 0.0F);
  double sum = 0;
  std::size_t object = 0;
  for (int v = std::max(padded_.v0, 0); v < std::min(padded_.v1, level.mask.height()); ++v) {
    for (int u = std::max(padded_.u0, 0); u < std::min(padded_.u1, level.mask.width()); ++u) {
      const float depth = log_depth(u, v);
      if (level.mask(u, v) == 0 || !std::isfinite(depth)) continue;
      const std::size_t i =
          static_cast<std::size_t>(v - padded_.v0) * stride_ + static_cast<std::size_t>(u - padded_.u0);
      depth_[i] = std::exp(depth);
      weight_[i] = 1.0F;
      weighted_[i] = level.reference(u, v);
      sum += depth_[i];
      ++object;
    }
  }
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
    const float max_x = static_cast<float>(candidate.image->width() - 1) - margin;
    const float max_y = static_cast<float>(candidate.image->height() - 1) - margin;
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

void TileMatcher::prepare(float centre, float half_range) {
  centre_ = centre;
  half_range_ = half_range;
  const std::size_t n = stride_ * rows_;
  std::vector<float> near_x(n), near_y(n), far_x(n), far_y(n);
  for (View& view : views_) {
    auto& path = view.path;
    project(view, centre - half_range, near_x, near_y);
    if (centre != projected_) project(view, centre, path[0], path[3]);
    project(view, centre + half_range, far_x, far_y);
    for (std::size_t i = 0; i < n; ++i) {
      path[1][i] = 0.5F * (far_x[i] - near_x[i]);
      path[2][i] = 0.5F * (far_x[i] + near_x[i]) - path[0][i];
      path[4][i] = 0.5F * (far_y[i] - near_y[i]);
      path[5][i] = 0.5F * (far_y[i] + near_y[i]) - path[3][i];
    }
  }
  projected_ = centre;
}

template <int radius>
void TileMatcher::correlate(const View& view, float t) {
  constexpr std::size_t ring = 2 * radius + 1;
  const auto width = static_cast<std::size_t>(tile_.width());
  const auto count = static_cast<Eigen::Index>(width);
  std::vector<float> warped(stride_), square(stride_), product(stride_), totals(3 * width);
  for (std::size_t v = 0; v < rows_; ++v) {
    const std::size_t row = v * stride_;
    std::array<const float*, 6> path;
    for (std::size_t k = 0; k < path.size(); ++k) path[k] = &view.path[k][row];
    sample_row(*view.view->image, path, t, stride_, warped.data());
    for (std::size_t u = 0; u < stride_; ++u) {
      const float value = warped[u] * weight_[row + u];
      square[u] = value * value;
      product[u] = warped[u] * weighted_[row + u];
      warped[u] = value;
    }
    float* const line = &sums_[3 * width * (v % ring)];
    horizontal_sums<radius>(warped.data(), width, line);
    horizontal_sums<radius>(square.data(), width, line + width);
    horizontal_sums<radius>(product.data(), width, line + 2 * width);
    if (v + 1 < ring) continue;
    for (std::size_t i = 0; i < 3 * width; ++i) {
      float sum = sums_[i];
      for (std::size_t k = 1; k < ring; ++k) sum += sums_[3 * width * k + i];
      totals[i] = sum;
    }
    const std::size_t out = (v + 1 - ring) * width;
    const ConstValues inverse(&inverse_count_[out], count), reference(&mean_[out], count);
    const ConstValues deviation(&inverse_deviation_[out], count), seen(&view.seen[out], count);
    const ConstValues squares(&totals[width], count), products(&totals[2 * width], count);
    Values sum(totals.data(), count), result(&correlation_[out], count);
    sum *= inverse;
    result = seen * ((products * inverse - sum * reference) * deviation /
                     ((squares * inverse - sum * sum).max(0.0F) + settings_.noise_variance).sqrt())
                        .max(0.0F);
  }
}

void TileMatcher::correlate(const View& view, float t) {
  switch (settings_.radius) {
    case 1:
      return correlate<1>(view, t);
    case 2:
      return correlate<2>(view, t);
    case 3:
      return correlate<3>(view, t);
    case 4:
      return correlate<4>(view, t);
    case 5:
      return correlate<5>(view, t);
    case 6:
      return correlate<6>(view, t);
    case 7:
      return correlate<7>(view, t);
    default:
      return correlate<8>(view, t);
  }
}

void TileMatcher::score(float offset, Scores& scores) {
  clear(best_);
  for (auto& best : half_best_) clear(best);
  const float t = (offset - centre_) / half_range_;
  for (const View& view : views_) {
    correlate(view, t);
    insert(correlation_, best_);
    if (settings_.compare_halves) insert(correlation_, half_best_[static_cast<std::size_t>(view.view->subset)]);
  }
  average(best_, count_, scores.all);
  if (!settings_.compare_halves) return;
  for (std::size_t k = 0; k < 2; ++k) average(half_best_[k], half_count_[k], scores.half[k]);
}

}  // namespace malus
