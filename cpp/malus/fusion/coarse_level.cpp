#include "malus/fusion/coarse_level.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "malus/core/parallel.h"

namespace malus {
namespace {

constexpr float none = std::numeric_limits<float>::quiet_NaN();

/// Calls visit(u, v) for the pixels under a coarse one for which `counts` is set.
template <class Visit>
void for_each_child(const Mask& counts, int column, int row, Visit&& visit) {
  for (int v = 2 * row; v < std::min(2 * row + 2, counts.height()); ++v) {
    for (int u = 2 * column; u < std::min(2 * column + 2, counts.width()); ++u) {
      if (counts(u, v)) visit(u, v);
    }
  }
}

void coarsen_surface(const RefinementField& fine, RefinementField& coarse, int column, int row) {
  double x = 0, x_prior = 0, sigma = 0;
  int count = 0, specular = 0;
  for_each_child(fine.object, column, row, [&](int u, int v) {
    x += fine.x(u, v);
    x_prior += fine.x_prior(u, v);
    sigma += fine.prior_sigma(u, v);
    specular += fine.kind_at(u, v) == Reflection::specular;
    ++count;
  });
  if (count == 0) return;
  coarse.object(column, row) = 255;
  coarse.x(column, row) = x / count / 2;
  coarse.x_prior(column, row) = x_prior / count / 2;
  coarse.prior_sigma(column, row) = static_cast<float>(sigma / count / 2);
  coarse.kind(column, row) =
      static_cast<std::uint8_t>(2 * specular > count ? Reflection::specular : Reflection::diffuse);
}

void coarsen_light(const RefinementField& fine, RefinementField& coarse, int column, int row) {
  float s0 = 0, s1 = 0, s2 = 0, variance = 0;
  int count = 0;
  for_each_child(fine.usable, column, row, [&](int u, int v) {
    s0 += fine.s0(u, v);
    s1 += fine.s1(u, v);
    s2 += fine.s2(u, v);
    variance += fine.variance(u, v);
    ++count;
  });
  if (count == 0) return;
  const float share = 1.0F / static_cast<float>(count);
  coarse.usable(column, row) = 255;
  coarse.s0(column, row) = share * s0;
  coarse.s1(column, row) = share * s1;
  coarse.s2(column, row) = share * s2;
  coarse.variance(column, row) = share * share * variance;
}

}  // namespace

RefinementField coarsened(const RefinementField& fine, const Context& context) {
  RefinementField coarse;
  coarse.camera = fine.camera.binned();
  coarse.focal = fine.focal / 2;
  coarse.log_depth_origin = fine.log_depth_origin;
  coarse.reflection = fine.reflection;
  coarse.shading = fine.shading;
  const Size size = coarse.camera.size;
  coarse.object = coarse.usable = Mask(size);
  coarse.x = coarse.x_prior = Image<double>(size, 1, std::numeric_limits<double>::quiet_NaN());
  coarse.prior_sigma = coarse.s0 = coarse.s1 = coarse.s2 = coarse.variance = Image<float>(size, 1, none);
  coarse.kind = Image<std::uint8_t>(size);
  parallel_rows(context, size.height, [&](int row) {
    for (int column = 0; column < size.width; ++column) {
      coarsen_surface(fine, coarse, column, row);
      coarsen_light(fine, coarse, column, row);
    }
  });
  prepare_weights(coarse);
  return coarse;
}

void take_over(RefinementField& fine, const RefinementField& coarse, const Context& context) {
  const RefinementField before = coarsened(fine, context);
  parallel_rows(context, fine.size().height, [&](int v) {
    for (int u = 0; u < fine.size().width; ++u) {
      if (!fine.object(u, v)) continue;
      const double at_u = (u - 0.5) / 2, at_v = (v - 0.5) / 2;
      const int column = static_cast<int>(std::floor(at_u)), row = static_cast<int>(std::floor(at_v));
      double sum = 0, weights = 0;
      for (int k = 0; k < 4; ++k) {
        const int i = column + k % 2, j = row + k / 2;
        if (!coarse.is_object(i, j)) continue;
        const double weight = (1 - std::abs(at_u - i)) * (1 - std::abs(at_v - j));
        sum += weight * (coarse.x(i, j) - before.x(i, j));
        weights += weight;
      }
      fine.x(u, v) += 2 * sum / weights;  // the pixel's own coarse one is always there
    }
  });
  fine.reflection = coarse.reflection;
  fine.shading = coarse.shading;
}

}  // namespace malus
