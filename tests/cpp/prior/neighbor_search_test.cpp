#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <utility>
#include <vector>

#include "malus/prior/neighbor_search_internal.h"

namespace malus {
namespace {

/// Points in row order. Some coincide, and the right half has few points.
std::vector<ViewPoint> points() {
  std::mt19937 generator(3);
  std::uniform_real_distribution<float> u(-0.5F, 99.5F), v(-0.5F, 59.5F);
  std::vector<ViewPoint> points;
  for (int i = 0; i < 3000; ++i) {
    const float at = u(generator);
    if (at < 50 || i % 40 == 0) points.push_back(ViewPoint::without_normal(at, v(generator), 0));
    if (i % 50 == 0) points.push_back(points.back());
  }
  std::ranges::stable_sort(points, {}, [](const ViewPoint& p) { return pixel_of(p.v, 60); });
  return points;
}

/// The k nearest points by exhaustive search.
std::vector<std::uint32_t> nearest(const std::vector<ViewPoint>& points, const std::vector<std::uint8_t>& left_out,
                                   std::size_t self, std::size_t k) {
  std::vector<std::pair<float, std::uint32_t>> others;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (i == self || (!left_out.empty() && left_out[i])) continue;
    const float du = points[i].u - points[self].u, dv = points[i].v - points[self].v;
    others.emplace_back(du * du + dv * dv, static_cast<std::uint32_t>(i));
  }
  std::ranges::sort(others);
  others.resize(std::min(k, others.size()));
  std::vector<std::uint32_t> numbers;
  for (const auto& other : others) numbers.push_back(other.second);
  std::ranges::sort(numbers);
  return numbers;
}

void expect_nearest(const std::vector<ViewPoint>& points, const std::vector<std::uint8_t>& left_out, std::size_t k,
                    int threads) {
  const Context context{.threads = threads};
  const NeighborSearch search(points, left_out, k, context);
  Neighbors found;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (!left_out.empty() && left_out[i]) continue;
    search.find(points[i], i, found);
    std::ranges::sort(found.indices);
    ASSERT_EQ(found.indices, nearest(points, left_out, i, k)) << "neighbors of point " << i;
    float farthest = 0;
    for (const std::uint32_t j : found.indices) {
      const float du = points[j].u - points[i].u, dv = points[j].v - points[i].v;
      farthest = std::max(farthest, du * du + dv * dv);
    }
    ASSERT_EQ(found.distance2, farthest);
  }
}

TEST(NeighborSearch, FindsTheNearestOfDenseAndOfScatteredPoints) {
  expect_nearest(points(), {}, 16, 1);
  expect_nearest(points(), {}, 5, 3);
}

TEST(NeighborSearch, SkipsPointsThatAreLeftOut) {
  const std::vector<ViewPoint> all = points();
  std::vector<std::uint8_t> left_out(all.size(), 0);
  for (std::size_t i = 0; i < all.size(); i += 3) left_out[i] = 1;
  expect_nearest(all, left_out, 16, 2);
}

TEST(NeighborSearch, ReturnsAllPointsIfThereAreFew) {
  const std::vector<ViewPoint> few{ViewPoint::without_normal(3, 0, 0), ViewPoint::without_normal(3, 0, 0),
                                   ViewPoint::without_normal(40, 30, 0)};
  expect_nearest(few, {}, 16, 1);
}

}  // namespace
}  // namespace malus
