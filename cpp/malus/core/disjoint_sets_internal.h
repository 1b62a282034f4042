#pragma once

#include <algorithm>
#include <cstddef>
#include <numeric>
#include <utility>
#include <vector>

namespace malus {

/// Sets of the numbers 0 … count − 1, at first each its own, that are joined pair by pair (Galler & Fischer 1964).
/// Several threads may join at once if no set reaches into the numbers of two of them.
class DisjointSets {
 public:
  explicit DisjointSets(std::size_t count) : parents_(count) { std::iota(parents_.begin(), parents_.end(), 0); }

  void join(int i, int j) {
    const int a = root(i), b = root(j);
    parent(std::max(a, b)) = std::min(a, b);
  }

  /// For each number which set it belongs to, numbered in the order of their least, and how many there are.
  std::pair<std::vector<int>, int> numbered() && {
    int count = 0;
    // Roots are the least of their sets: they have a number before the others need it.
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
