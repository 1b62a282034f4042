#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

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

/// The criteria for one direction, by a plain search: the match of each row of `a` in `b`, -1 if there is none.
std::vector<int> plain_search(const Descriptors& a, const Descriptors& b) {
  const Eigen::MatrixXi products = a.cast<int>() * b.cast<int>().transpose();
  std::vector<int> found;
  for (Eigen::Index i = 0; i < a.rows(); ++i) {
    Eigen::Index best = 0;
    const double first = std::acos(std::min(products.row(i).maxCoeff(&best) / (512.0 * 512.0), 1.0));
    Eigen::RowVectorXi others = products.row(i);
    others[best] = 0;
    const double second = std::acos(others.maxCoeff() / (512.0 * 512.0));
    found.push_back(first <= 0.7 && first < 0.8 * second ? static_cast<int>(best) : -1);
  }
  return found;
}

TEST(MatchFeatures, GivesTheMatchesOfAPlainSearch) {
  const Descriptors a = random_descriptors(700, 6);
  Descriptors b = random_descriptors(530, 7);
  std::mt19937 random(8);
  std::normal_distribution<double> noise(0, 12);
  for (Eigen::Index k = 0; k < b.rows(); k += 2) {  // half of them are those of a, with noise
    Eigen::RowVectorXd row = a.row((k * 13) % a.rows()).cast<double>();
    for (double& x : row) x = std::max(x + noise(random), 0.0);
    b.row(k) = (512 * row.normalized()).array().round().min(255).cast<std::uint8_t>();
  }
  const std::vector<int> of_a = plain_search(a, b), of_b = plain_search(b, a);
  std::vector<std::pair<std::uint32_t, std::uint32_t>> expected;
  for (std::uint32_t i = 0; i < of_a.size(); ++i) {
    const int j = of_a[i];
    if (j >= 0 && of_b[static_cast<std::size_t>(j)] == static_cast<int>(i)) expected.emplace_back(i, j);
  }
  EXPECT_GT(expected.size(), 150U);
  EXPECT_LT(expected.size(), 530U);
  EXPECT_EQ(match_features(a, b), expected);
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
