#include <cblas.h>

#include <algorithm>
#include <cmath>

#include "malus/core/parallel_internal.h"
#include "malus/linalg/sequential_blas_internal.h"
#include "malus/photogrammetry/feature_matching_internal.h"

namespace malus {
namespace {

/// Product of two descriptors of equal direction.
constexpr float full_product = 512.0F * 512.0F;

/// Largest ratio of the angles to the best and the second-best descriptor (Lowe 2004).
constexpr double max_ratio = 0.8;
/// Largest angle between matching descriptors.
constexpr double max_distance_rad = 0.7;

/// Products of all descriptors of one photo with all of another are computed in squares of this side, which stay in the
/// cache. They are whole numbers below 2^24, so that single precision is exact, with any BLAS.
constexpr int side = 256;
using Rows = Eigen::Matrix<float, Eigen::Dynamic, 128, Eigen::RowMajor>;

/// For each feature of a photo the two largest products with features of the other photo so far, and the index of the
/// feature with the larger one.
struct Nearest {
  std::vector<float> best, second;
  std::vector<std::uint32_t> index;

  explicit Nearest(Eigen::Index count)
      : best(static_cast<std::size_t>(count)), second(best.size()), index(best.size()) {}

  void offer(std::size_t feature, float product, std::size_t candidate) {
    if (product > best[feature]) {
      second[feature] = best[feature];
      best[feature] = product;
      index[feature] = static_cast<std::uint32_t>(candidate);
    } else if (product > second[feature]) {
      second[feature] = product;
    }
  }
  bool is_distinct(std::size_t feature) const {
    const double nearest = std::acos(std::min(best[feature] / full_product, 1.0F));
    const double next = std::acos(std::min(second[feature] / full_product, 1.0F));
    return best[feature] > 0 && nearest <= max_distance_rad && nearest < max_ratio * next;
  }
};

/// Offers the products of feature `i` of the first photo with `count` features of the second one, from `first` on.
void offer_row(const float* products, std::size_t i, std::size_t first, std::size_t count, Nearest& of_a,
               Nearest& of_b) {
  // Few products are among the largest; comparing several at once passes over the others.
  constexpr std::size_t run = 16;
  for (std::size_t start = 0; start < count; start += run) {
    const std::size_t end = std::min(start + run, count);
    const float limit = of_a.second[i];
    int counts = 0;
    for (std::size_t k = start; k < end; ++k) counts |= products[k] > std::min(limit, of_b.second[first + k]) ? 1 : 0;
    if (counts == 0) continue;
    for (std::size_t k = start; k < end; ++k) {
      of_a.offer(i, products[k], first + k);
      of_b.offer(first + k, products[k], i);
    }
  }
}

}  // namespace

std::vector<std::pair<std::uint32_t, std::uint32_t>> match_features(const Descriptors& a, const Descriptors& b) {
  const SequentialBlas blas;
  const Rows rows_a = a.cast<float>(), rows_b = b.cast<float>();
  Nearest of_a(a.rows()), of_b(b.rows());
  std::vector<float> products(static_cast<std::size_t>(side) * side);
  for (Eigen::Index first_b = 0; first_b < b.rows(); first_b += side) {
    const auto count_b = static_cast<int>(std::min<Eigen::Index>(side, b.rows() - first_b));
    for (Eigen::Index first_a = 0; first_a < a.rows(); first_a += side) {
      const auto count_a = static_cast<int>(std::min<Eigen::Index>(side, a.rows() - first_a));
      cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasTrans, count_a, count_b, 128, 1, rows_a.row(first_a).data(), 128,
                  rows_b.row(first_b).data(), 128, 0, products.data(), side);
      for (int i = 0; i < count_a; ++i) {
        offer_row(&products[static_cast<std::size_t>(i) * side], static_cast<std::size_t>(first_a + i),
                  static_cast<std::size_t>(first_b), static_cast<std::size_t>(count_b), of_a, of_b);
      }
    }
  }
  std::vector<std::pair<std::uint32_t, std::uint32_t>> matches;
  for (std::uint32_t i = 0; i < of_a.index.size(); ++i) {
    if (!of_a.is_distinct(i)) continue;
    const std::uint32_t j = of_a.index[i];
    if (of_b.index[j] == i && of_b.is_distinct(j)) matches.emplace_back(i, j);
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
