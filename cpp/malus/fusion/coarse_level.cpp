#include <cmath>

#include "malus/core/parallel_internal.h"
#include "malus/fusion/coarse_level_internal.h"

namespace malus {
namespace {

/// Value at a coarse node: that of the fine node at the same place, or the mean of the fine nodes around it if that one
/// is not on the object.
template <class Value>
double at_coarse_node(const RefinementImage& fine, int column, int row, Value&& value) {
  if (fine.is_object(2 * column, 2 * row)) return value(2 * column, 2 * row);
  double sum = 0;
  int count = 0;
  for (int v = 2 * row - 1; v <= 2 * row + 1; ++v) {
    for (int u = 2 * column - 1; u <= 2 * column + 1; ++u) {
      if (!fine.is_object(u, v)) continue;
      sum += value(u, v);
      ++count;
    }
  }
  return sum / count;
}

/// x of a coarse node, in the coarse GSD.
double coarse_x(const RefinementImage& fine, int column, int row) {
  return at_coarse_node(fine, column, row, [&](int u, int v) { return fine.x(u, v); }) / 2;
}

/// Mean Stokes data of the fine pixels of a coarse pixel; it is usable if one of them is.
PixelData coarse_light(const RefinementImage& fine, RefinementImage& coarse, int column, int row) {
  PixelData pixel;
  int usable = 0;
  for_each_pixel(cell_rect(column, row, 2, fine.size()), fine.usable, [&](int u, int v) {
    const PixelData child = fine.source(u, v);
    pixel.s0 += child.s0;
    pixel.s1 += child.s1;
    pixel.s2 += child.s2;
    pixel.variance += child.variance;
    ++usable;
  });
  if (usable == 0) return pixel;
  coarse.usable(column, row) = 255;
  const float share = 1.0F / static_cast<float>(usable);
  pixel.s0 *= share;
  pixel.s1 *= share;
  pixel.s2 *= share;
  pixel.variance *= share * share;
  return pixel;
}

/// Marks a coarse pixel as on the object if one of its fine pixels is; it reflects like most of them.
void add_coarse_pixel(const RefinementImage& fine, RefinementImage& coarse, int column, int row) {
  int count = 0, specular = 0, other_finish = 0;
  for_each_pixel(cell_rect(column, row, 2, fine.size()), fine.pixels, [&](int u, int v) {
    specular += fine.kind(u, v) == Reflection::specular;
    other_finish += fine.has_other_finish(u, v);
    ++count;
  });
  if (count == 0) return;
  coarse.pixels(column, row) = 255;
  coarse.kind(column, row) = 2 * specular > count ? Reflection::specular : Reflection::diffuse;
  if (2 * other_finish > count) coarse.other_finish(column, row) = 255;
}

}  // namespace

RefinementImage coarsened(const RefinementImage& fine, const Context& context) {
  RefinementImage coarse;
  coarse.camera = fine.camera.binned();
  coarse.log_depth_origin = fine.log_depth_origin;
  coarse.reflection = fine.reflection;
  coarse.shading = fine.shading;
  const Size size{fine.size().width / 2 + 1, fine.size().height / 2 + 1};
  coarse.pixels = coarse.usable = Mask(size);
  if (!fine.other_finish.empty()) coarse.other_finish = Mask(size);
  coarse.x = Image<double>(size, 1, no_value);
  coarse.kind = Image<Reflection>(size);
  auto pixels = Image<PixelData>::uninitialized(size);
  parallel_pixels(context, size, [&](int column, int row) { add_coarse_pixel(fine, coarse, column, row); });
  coarse.object = nodes_of(coarse.pixels);
  parallel_pixels(context, coarse.object, [&](int column, int row) {
    PixelData& pixel = pixels(column, row) = coarse_light(fine, coarse, column, row);
    pixel.x_prior = at_coarse_node(fine, column, row, [&](int u, int v) { return fine.source(u, v).x_prior; }) / 2;
    pixel.prior_sigma = static_cast<float>(
        at_coarse_node(fine, column, row, [&](int u, int v) { return fine.source(u, v).prior_sigma; }) / 2);
    coarse.x(column, row) = coarse_x(fine, column, row);
  });
  coarse.source = [means = std::move(pixels)](int u, int v) { return means(u, v); };
  return coarse;
}

void take_over(RefinementImage& fine, const RefinementImage& coarse, const Context& context) {
  Image<double> change(coarse.size());
  parallel_pixels(context, coarse.object, [&](int column, int row) {
    change(column, row) = coarse.x(column, row) - coarse_x(fine, column, row);
  });
  parallel_pixels(context, fine.object, [&](int u, int v) {
    const double at_u = u / 2.0, at_v = v / 2.0;
    const int column = u / 2, row = v / 2;
    double sum = 0, weights = 0;
    for (int k = 0; k < 4; ++k) {
      const int i = column + k % 2, j = row + k / 2;
      if (!coarse.is_object(i, j)) continue;
      const double weight = (1 - std::abs(at_u - i)) * (1 - std::abs(at_v - j));
      sum += weight * change(i, j);
      weights += weight;
    }
    fine.x(u, v) += 2 * sum / weights;  // at least one coarse node is always on the object
  });
  fine.reflection = coarse.reflection;
  fine.shading = coarse.shading;
}

}  // namespace malus
