#include <gtest/gtest.h>

#include <random>

#include "malus/photogrammetry/feature_matching_internal.h"

namespace malus {
namespace {

/// Random descriptors of length 512.
Descriptors random_descriptors(Eigen::Index count, unsigned seed) {
  std::mt19937 random(seed);
  std::exponential_distribution<double> value(1.0);
  Descriptors descriptors(count, 128);
  for (Eigen::Index i = 0; i < count; ++i) {
    Eigen::VectorXd row(128);
    for (double& x : row) x = value(random);
    descriptors.row(i) = (512 * row.normalized()).array().round().min(255).cast<std::uint8_t>();
  }
  return descriptors;
}

TEST(MatchFeatures, FindsAPermutation) {
  const Descriptors a = random_descriptors(150, 1);
  Descriptors b(a.rows(), 128);
  for (Eigen::Index i = 0; i < a.rows(); ++i) b.row((i * 7) % 150) = a.row(i);
  const auto matches = match_features(a, b);
  ASSERT_EQ(matches.size(), 150U);
  for (const auto& [i, j] : matches) EXPECT_EQ(j, (i * 7) % 150);
}

TEST(MatchFeatures, LeavesOutAmbiguousAndDistantMatches) {
  const Descriptors a = random_descriptors(20, 2);
  Descriptors twice(40, 128);
  twice << a, a;
  EXPECT_TRUE(match_features(a, twice).empty());
  EXPECT_TRUE(match_features(twice, a).empty());
  EXPECT_TRUE(match_features(a, random_descriptors(1, 3)).empty());
  EXPECT_TRUE(match_features(a, Descriptors(0, 128)).empty());
}

TEST(MatchPairs, DoesNotDependOnThreads) {
  const std::vector<Descriptors> photos{random_descriptors(90, 4), random_descriptors(70, 5),
                                        random_descriptors(80, 4)};
  const std::vector<std::pair<std::size_t, std::size_t>> pairs{{0, 1}, {0, 2}, {1, 2}};
  const Context several{.threads = 3};
  const auto matches = match_pairs(photos, pairs, several);
  EXPECT_EQ(matches, match_pairs(photos, pairs, {}));
  EXPECT_EQ(matches[1].size(), 80U);
  const std::vector<std::pair<std::size_t, std::size_t>> wrong{{0, 3}};
  EXPECT_THROW(match_pairs(photos, wrong, {}), Error);
}

}  // namespace
}  // namespace malus
