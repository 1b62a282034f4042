#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "malus/prior/visible_points_internal.h"
#include "prior/cloud_scenes.h"

namespace malus {
namespace {

using namespace cloud_scenes;

VisiblePoints visible(const PointCloud& cloud, int threads) {
  const Context context{.threads = threads};
  const Pinhole camera = cloud_scenes::test_camera();
  return visible_points(cloud, camera, {}, Mask(camera.size, 1, 255), {}, context);
}

TEST(VisiblePoints, AreTheSameWithMoreThreads) {
  const VisiblePoints one = visible(cluttered(true), 1), three = visible(cluttered(true), 3);
  ASSERT_EQ(one.points.size(), three.points.size());
  EXPECT_EQ(one.reference_depth, three.reference_depth);
  EXPECT_EQ(one.spacing_px, three.spacing_px);
  for (std::size_t i = 0; i < one.points.size(); ++i) {
    ASSERT_EQ(one.points[i].u, three.points[i].u);
    ASSERT_EQ(one.points[i].v, three.points[i].v);
    ASSERT_EQ(one.points[i].height, three.points[i].height);
  }
}

TEST(VisiblePoints, HiddenPointsDoNotAffectTheVisibleOnes) {
  const VisiblePoints with = visible(cluttered(true), 1), without = visible(cluttered(false), 1);
  EXPECT_EQ(with.census.hidden, 1500U);
  EXPECT_EQ(without.census.hidden, 0U);
  EXPECT_GT(without.census.outliers, 0U);
  EXPECT_EQ(with.census.outliers, without.census.outliers);
  EXPECT_EQ(with.spacing_px, without.spacing_px);
  ASSERT_EQ(with.points.size(), without.points.size());
  for (std::size_t i = 0; i < with.points.size(); ++i) {
    ASSERT_EQ(with.points[i].u, without.points[i].u);
    ASSERT_EQ(with.points[i].v, without.points[i].v);
  }
}

TEST(VisiblePoints, SpacingIsThatOfTheNearestNeighbors) {
  // A dense and a sparse set of points.
  PointCloud cloud;
  add_wave(cloud, 3000, 0, 0.5, 0, 4);
  add_wave(cloud, 60, 0.5, 1, 0, 7);
  const VisiblePoints found = visible(cloud, 1);
  ASSERT_EQ(found.census.hidden + found.census.outliers, 0U);
  std::vector<double> spacings;
  for (const ViewPoint& p : found.points) {
    std::vector<float> distances;
    for (const ViewPoint& q : found.points) {
      const float du = q.u - p.u, dv = q.v - p.v;
      distances.push_back(du * du + dv * dv);
    }
    const auto sixteenth = distances.begin() + 16;  // the first is the point itself
    std::nth_element(distances.begin(), sixteenth, distances.end());
    spacings.push_back(std::sqrt(std::numbers::pi * *sixteenth / 16));
  }
  const auto middle = spacings.begin() + static_cast<std::ptrdiff_t>(spacings.size() / 2);
  std::nth_element(spacings.begin(), middle, spacings.end());
  EXPECT_DOUBLE_EQ(found.spacing_px, *middle);
}

}  // namespace
}  // namespace malus
