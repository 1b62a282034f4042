#include <algorithm>
#include <cmath>

#include "malus/core/parallel_internal.h"
#include "malus/photogrammetry/feature_matching_internal.h"

namespace malus {
namespace {

constexpr Eigen::Index block = 64;
/// Product of two descriptors of equal direction.
constexpr double full_product = 512.0 * 512.0;

/// Largest ratio of the angles to the best and the second-best descriptor (Lowe 2004).
constexpr double max_ratio = 0.8;
/// Largest angle between matching descriptors.
constexpr double max_distance_rad = 0.7;

/// Rows as 16-bit numbers, whose products the compiler sums eight at a time.
using Wide = Eigen::Matrix<std::int16_t, Eigen::Dynamic, 128, Eigen::RowMajor>;

std::int32_t product(const std::int16_t* a, const std::int16_t* b) {
  std::int32_t sum = 0;
  for (int k = 0; k < 128; ++k) sum += static_cast<std::int32_t>(a[k]) * b[k];
  return sum;
}

/// The two largest products of a feature so far, and the index of the feature with the larger one.
struct Nearest {
  std::int32_t best = 0, second = 0;
  std::uint32_t index = 0;

  void offer(std::int32_t value, Eigen::Index candidate) {
    if (value > best) {
      second = best;
      best = value;
      index = static_cast<std::uint32_t>(candidate);
    } else if (value > second) {
      second = value;
    }
  }
  bool is_distinct() const {
    const double nearest = std::acos(std::min(best / full_product, 1.0));
    const double next = std::acos(std::min(second / full_product, 1.0));
    return best > 0 && nearest <= max_distance_rad && nearest < max_ratio * next;
  }
};

}  // namespace

std::vector<std::pair<std::uint32_t, std::uint32_t>> match_features(const Descriptors& a, const Descriptors& b) {
  const Wide wide_a = a.cast<std::int16_t>(), wide_b = b.cast<std::int16_t>();
  std::vector<Nearest> of_a(static_cast<std::size_t>(a.rows())), of_b(static_cast<std::size_t>(b.rows()));
  for (Eigen::Index first = 0; first < b.rows(); first += block) {
    const Eigen::Index last = std::min(first + block, b.rows());
    for (Eigen::Index i = 0; i < a.rows(); ++i) {
      for (Eigen::Index j = first; j < last; ++j) {
        const std::int32_t value = product(wide_a.row(i).data(), wide_b.row(j).data());
        of_a[static_cast<std::size_t>(i)].offer(value, j);
        of_b[static_cast<std::size_t>(j)].offer(value, i);
      }
    }
  }
  std::vector<std::pair<std::uint32_t, std::uint32_t>> matches;
  for (std::uint32_t i = 0; i < of_a.size(); ++i) {
    const Nearest& nearest = of_a[i];
    if (!nearest.is_distinct()) continue;
    const Nearest& back = of_b[nearest.index];
    if (back.index == i && back.is_distinct()) matches.emplace_back(i, nearest.index);
  }
  return matches;
}

std::vector<std::vector<std::pair<std::uint32_t, std::uint32_t>>> match_pairs(
    std::span<const Descriptors> photos, std::span<const std::pair<std::size_t, std::size_t>> pairs,
    const Context& context) {
  for (const auto& [first, second] : pairs) {
    if (std::max(first, second) >= photos.size()) {
      throw input_error("pair of photos " + std::to_string(first) + " and " + std::to_string(second) + " of " +
                        std::to_string(photos.size()));
    }
  }
  std::vector<std::vector<std::pair<std::uint32_t, std::uint32_t>>> matches(pairs.size());
  const auto count = static_cast<std::size_t>(std::max(context.threads, 1));
  for (std::size_t start = 0; start < pairs.size(); start += count) {
    context.check_cancel();
    context.progress("matches", static_cast<double>(start) / static_cast<double>(pairs.size()),
                     "pair " + std::to_string(start + 1) + "/" + std::to_string(pairs.size()));
    parallel_for(context, std::min(count, pairs.size() - start), 1, [&](std::size_t i, std::size_t) {
      const auto& [first, second] = pairs[start + i];
      matches[start + i] = match_features(photos[first], photos[second]);
    });
  }
  return matches;
}

}  // namespace malus
