#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "malus/assess/high_pass_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/simd_internal.h"

namespace malus {
namespace {

/// What is filtered at once stays in a core's cache.
constexpr int tile_width = 512, tile_height = 256;

/// Weights of the offsets 0 … radius; one side of the Gaussian.
std::vector<float> half_kernel(double sigma_px) {
  std::vector<float> kernel(static_cast<std::size_t>(4 * sigma_px + 0.5) + 1);
  for (std::size_t i = 0; i < kernel.size(); ++i) {
    kernel[i] = static_cast<float>(std::exp(-0.5 * std::pow(static_cast<double>(i) / sigma_px, 2)));
  }
  return kernel;
}

/// Index of a position beyond an end, mirrored about the outer edge of the last pixel (… 1 0 | 0 1 …).
int mirrored(int index, int size) {
  if (index >= 0 && index < size) return index;
  const int wrapped = ((index % (2 * size)) + 2 * size) % (2 * size);
  return wrapped < size ? wrapped : 2 * size - 1 - wrapped;
}

/// Weighted sums over the neighbors of `count` consecutive values on either side, `stride` values apart. Compiled
/// without fused multiplications, so that processors agree to the bit.
MALUS_SIMD_CLONES void blur_line(const float* centre, std::ptrdiff_t stride, const float* kernel, int radius, int count,
                                 float* sums) {
  constexpr int lane = 32;
  int first = 0;
  for (; first + lane <= count; first += lane) {
    const float* const here = centre + first;
    float sum[lane];
    for (int i = 0; i < lane; ++i) sum[i] = kernel[0] * here[i];
    for (int k = 1; k <= radius; ++k) {
      const float *const before = here - k * stride, *const after = here + k * stride;
      for (int i = 0; i < lane; ++i) sum[i] += kernel[k] * (before[i] + after[i]);
    }
    for (int i = 0; i < lane; ++i) sums[first + i] = sum[i];
  }
  for (; first < count; ++first) {
    float sum = kernel[0] * centre[first];
    for (int k = 1; k <= radius; ++k) sum += kernel[k] * (centre[first - k * stride] + centre[first + k * stride]);
    sums[first] = sum;
  }
}

/// Filters one tile after the other with memory that it keeps.
class TileFilter {
 public:
  TileFilter(Size size, const RowSource& values, float mean, const std::vector<float>& kernel)
      : size_(size), values_(values), mean_(mean), kernel_(kernel), radius_(static_cast<int>(kernel.size()) - 1) {
    const auto width = static_cast<std::size_t>(tile_width), ring = static_cast<std::size_t>(2 * radius_);
    const std::size_t rows = static_cast<std::size_t>(tile_height) + ring;
    row_.resize(width + ring);
    padded_.resize(width + ring);
    known_.resize(width + ring);
    sums_.resize(rows * width);
    weights_.resize(rows * width);
    sum_.resize(width);
    weight_.resize(width);
  }

  void run(int u0, int v0, int u1, int v1, Image<float>& result) {
    bool complete = true;
    for (int v = v0 - radius_; v < v1 + radius_; ++v) {
      const std::size_t line = static_cast<std::size_t>(v - v0 + radius_) * tile_width;
      const bool row_complete = load(mirrored(v, size_.height), u0, u1);
      complete = complete && row_complete;
      blur(padded_.data() + radius_, 1, u1 - u0, sums_.data() + line);
      if (row_complete) {
        std::fill_n(weights_.data() + line, u1 - u0, weight_of_ones(1));
      } else {
        blur(known_.data() + radius_, 1, u1 - u0, weights_.data() + line);
      }
    }
    std::ranges::fill(weight_, weight_of_ones(weight_of_ones(1)));
    for (int v = v0; v < v1; ++v) {
      const std::size_t line = static_cast<std::size_t>(v - v0 + radius_) * tile_width;
      blur(sums_.data() + line, tile_width, u1 - u0, sum_.data());
      if (!complete) blur(weights_.data() + line, tile_width, u1 - u0, weight_.data());
      float* const row = result.row(v);
      values_(v, u0, u1, row + u0);
      for (int u = u0; u < u1; ++u) {
        const auto i = static_cast<std::size_t>(u - u0);
        row[u] = (row[u] - mean_) - sum_[i] / weight_[i];
      }
    }
  }

 private:
  /// Values about the mean, 0 for missing ones, of a row of the tile and of what lies beyond its ends; and where they
  /// are known. Returns whether all are.
  bool load(int v, int u0, int u1) {
    const int begin = std::max(u0 - radius_, 0), end = std::min(u1 + radius_, size_.width);
    values_(v, begin, end, row_.data());
    bool complete = true;
    for (int u = u0 - radius_; u < u1 + radius_; ++u) {
      const float value = row_[static_cast<std::size_t>(mirrored(u, size_.width) - begin)];
      const bool is_known = std::isfinite(value);
      const auto i = static_cast<std::size_t>(u - u0 + radius_);
      padded_[i] = is_known ? value - mean_ : 0;
      known_[i] = is_known ? 1 : 0;
      complete = complete && is_known;
    }
    return complete;
  }

  void blur(const float* centre, std::ptrdiff_t stride, int count, float* sums) const {
    blur_line(centre, stride, kernel_.data(), radius_, count, sums);
  }
  /// What blur makes of a line of this value, in the same order.
  float weight_of_ones(float value) const {
    float sum = kernel_[0] * value;
    for (std::size_t k = 1; k < kernel_.size(); ++k) sum += kernel_[k] * (value + value);
    return sum;
  }

  Size size_;
  const RowSource& values_;
  float mean_;
  const std::vector<float>& kernel_;
  int radius_;
  std::vector<float> row_, padded_, known_, sums_, weights_, sum_, weight_;
};

/// Mean of the finite values; any constant would do, but taking it away keeps the digits of float sums.
float mean_of(Size size, const RowSource& values, const Context& context) {
  struct Sum {
    double values = 0, count = 0;
    Sum& operator+=(const Sum& other) {
      values += other.values, count += other.count;
      return *this;
    }
  };
  const Sum sum =
      parallel_sum(context, static_cast<std::size_t>(size.height), 16, Sum{}, [&](std::size_t begin, std::size_t end) {
        std::vector<float> row(static_cast<std::size_t>(size.width));
        Sum part;
        for (std::size_t v = begin; v < end; ++v) {
          values(static_cast<int>(v), 0, size.width, row.data());
          for (const float value : row) {
            if (std::isfinite(value)) part.values += value, ++part.count;
          }
        }
        return part;
      });
  return sum.count > 0 ? static_cast<float>(sum.values / sum.count) : 0;
}

}  // namespace

Image<float> high_pass(Size size, const RowSource& values, double sigma_px, const Context& context) {
  Image<float> result = Image<float>::uninitialized(size);
  if (result.empty()) return result;
  const std::vector<float> kernel = half_kernel(sigma_px);
  const float mean = mean_of(size, values, context);
  const int columns = (size.width + tile_width - 1) / tile_width, rows = (size.height + tile_height - 1) / tile_height;
  // Rows of tiles, so that the memory of a filter serves several.
  parallel_for(context, static_cast<std::size_t>(rows), 1, [&](std::size_t row, std::size_t) {
    TileFilter filter(size, values, mean, kernel);
    const int v0 = static_cast<int>(row) * tile_height, v1 = std::min(v0 + tile_height, size.height);
    for (int column = 0; column < columns; ++column) {
      context.check_cancel();
      filter.run(column * tile_width, v0, std::min((column + 1) * tile_width, size.width), v1, result);
    }
  });
  return result;
}

Image<float> high_pass(const Image<float>& values, double sigma_px, const Context& context) {
  const RowSource rows = [&values](int v, int begin, int end, float* to) {
    std::copy(values.row(v) + begin, values.row(v) + end, to);
  };
  return high_pass(values.size(), rows, sigma_px, context);
}

}  // namespace malus
