#include <gtest/gtest.h>

#include <algorithm>

#include "height_like_system.h"
#include "malus/linalg/nested_dissection_internal.h"

namespace malus {
namespace {

TEST(NestedDissection, OrdersEveryUnknownOnce) {
  Mask mask({77, 41}, 1, 1);
  for (int v = 10; v < 30; ++v) std::fill(mask.row(v) + 20, mask.row(v) + 50, 0);
  const PixelIndex pixels(mask);
  std::vector<int> order = nested_dissection(pixels, 2);
  std::sort(order.begin(), order.end());
  ASSERT_EQ(order.size(), static_cast<std::size_t>(pixels.count()));
  for (int i = 0; i < pixels.count(); ++i) EXPECT_EQ(order[static_cast<std::size_t>(i)], i);
}

TEST(NestedDissection, FillsInLittleMoreThanAGraphPartitioner) {
  const PixelIndex pixels(Mask({200, 200}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  const auto matrix = system.lower(1e-9);
  SymmetricSolver by_graph{Context{}}, by_position{Context{}};
  by_graph.analyze(matrix);
  by_position.analyze(matrix, nested_dissection(pixels, GridSystem::reach));
  EXPECT_LT(by_position.factor_bytes(), 1.6 * by_graph.factor_bytes());
  Eigen::VectorXd x, y;
  ASSERT_EQ(by_graph.factorize(matrix), SolveStatus::solved);
  ASSERT_EQ(by_position.factorize(matrix), SolveStatus::solved);
  ASSERT_EQ(by_graph.solve(matrix, system.right(), x), SolveStatus::solved);
  ASSERT_EQ(by_position.solve(matrix, system.right(), y), SolveStatus::solved);
  EXPECT_LT((x - y).norm(), 1e-6 * x.norm());
}

TEST(NestedDissection, AnOrderOfAnotherSizeIsAnInputError) {
  const PixelIndex pixels(Mask({9, 9}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  SymmetricSolver solver{Context{}};
  const std::vector<int> order(7, 0);
  EXPECT_THROW(solver.analyze(system.lower(1), order), Error);
}

}  // namespace
}  // namespace malus
