#pragma once

#include <algorithm>
#include <cstddef>
#include <numeric>
#include <utility>
#include <vector>

namespace malus {

/// Union-find over the numbers 0 … count − 1: each starts as a set of its own, and sets are joined pair by pair (Galler
/// & Fischer 1964). Several threads may join at once if each has its own numbers and no set holds numbers of two
/// threads.
class DisjointSets {
 public:
  explicit DisjointSets(std::size_t count) : parents_(count) { std::iota(parents_.begin(), parents_.end(), 0); }

  void join(int i, int j) {
    const int a = root(i), b = root(j);
    parent(std::max(a, b)) = std::min(a, b);
  }

  /// For each number the index of its set, and how many sets there are. Sets are ordered by their smallest members.
  std::pair<std::vector<int>, int> numbered() && {
    int count = 0;
    // A root is the smallest member of its set, so it has its index before other members look it up.
    for (std::size_t i = 0; i < parents_.size(); ++i) {
      parents_[i] = parents_[i] == static_cast<int>(i) ? count++ : parent(parents_[i]);
    }
    return {std::move(parents_), count};
  }

 private:
  int& parent(int i) { return parents_[static_cast<std::size_t>(i)]; }
  int root(int i) {
    while (parent(i) != i) {
      parent(i) = parent(parent(i));
      i = parent(i);
    }
    return i;
  }

  std::vector<int> parents_;
};

}  // namespace malus
