#pragma once

#include <cmath>
#include <cstddef>

namespace malus {

/// An adjustment, once with all of its points and once without the one that lowers the squared residuals most.
struct BetterFit {
  double all = 0, others = 0;  ///< sums of squared residuals
  double points = 0;           ///< all of them
  double coordinates = 0;      ///< that each point observes, two or more
  double unknowns = 0;

  /// Fewer points cannot tell which of them is wrong.
  static constexpr std::size_t least_points = 5;

  double freedom_of_all() const { return points * coordinates - unknowns; }
  double freedom_of_others() const { return freedom_of_all() - coordinates; }

  /// Chance that this happens where no point is wrong and all errors are normal and alike. The share others / all of
  /// any one point then has a beta distribution (the F test of a shifted mean; Baarda 1968). Its tail is taken without
  /// the factor (1 − share)^(coordinates / 2 − 1), which is exact for two coordinates and an upper bound for more, and
  /// added over all points (Bonferroni).
  double chance() const {
    const double a = freedom_of_others() / 2, b = coordinates / 2;
    const double beta = std::exp(std::lgamma(a) + std::lgamma(b) - std::lgamma(a + b));
    return points * std::pow(others / all, a) / (a * beta);
  }

  /// Whether the point is worth a person's look: the others have a standard deviation of at most a third, which chance
  /// alone gives once in a hundred adjustments at most.
  bool is_telling() const {
    constexpr double far_better = 3, once_in_a_hundred = 0.01;
    return far_better * far_better * others * freedom_of_all() <= all * freedom_of_others() &&
           chance() <= once_in_a_hundred;
  }
};

}  // namespace malus
