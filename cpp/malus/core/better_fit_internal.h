#pragma once

#include <cmath>
#include <cstddef>

namespace malus {

/// An adjustment with all of its points, and again without the point whose removal lowers the squared residuals most.
struct BetterFit {
  double all = 0, others = 0;  ///< sums of squared residuals with all points, and without that one
  double points = 0;           ///< number of all points
  double coordinates = 0;      ///< number that each point observes, two or more
  double unknowns = 0;

  /// With fewer points it cannot be decided which one is wrong.
  static constexpr std::size_t least_points = 5;

  double freedom_of_all() const { return points * coordinates - unknowns; }
  double freedom_of_others() const { return freedom_of_all() - coordinates; }

  /// Probability of such a reduction if no point is wrong and all errors are normal with equal variance. The share
  /// others / all of any one point then has a beta distribution (the F test of a shifted mean; Baarda 1968). Its tail
  /// is computed without the factor (1 − share)^(coordinates / 2 − 1), which is exact for two coordinates and an upper
  /// bound for more, and summed over all points (Bonferroni).
  double chance() const {
    const double a = freedom_of_others() / 2, b = coordinates / 2;
    const double beta = std::exp(std::lgamma(a) + std::lgamma(b) - std::lgamma(a + b));
    return points * std::pow(others / all, a) / (a * beta);
  }

  /// Whether a person should check the point: without it the standard deviation falls to at most a third, and chance
  /// alone causes that in at most one of a hundred adjustments.
  bool is_telling() const {
    constexpr double far_better = 3, once_in_a_hundred = 0.01;
    return far_better * far_better * others * freedom_of_all() <= all * freedom_of_others() &&
           chance() <= once_in_a_hundred;
  }
};

}  // namespace malus
