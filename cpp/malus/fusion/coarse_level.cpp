#include <algorithm>
#include <cmath>
#include <limits>

#include "malus/core/parallel_internal.h"
#include "malus/fusion/coarse_level_internal.h"

namespace malus {
namespace {

/// Pixels that are means of others.
class CoarsePixels final : public PixelSource {
 public:
  explicit CoarsePixels(Size size) : pixels_(Image<PixelData>::uninitialized(size)) {}
  PixelData at(int u, int v) const override { return pixels_(u, v); }
  PixelData& operator()(int u, int v) { return pixels_(u, v); }

 private:
  Image<PixelData> pixels_;
};

/// Calls visit(u, v) for the pixels under a coarse one for which `counts` is set.
template <class Visit>
void for_each_child(const Mask& counts, int column, int row, Visit&& visit) {
  for (int v = 2 * row; v < std::min(2 * row + 2, counts.height()); ++v) {
    for (int u = 2 * column; u < std::min(2 * column + 2, counts.width()); ++u) {
      if (counts(u, v)) visit(u, v);
    }
  }
}

/// x of a coarse pixel with at least one child on the object, in the coarse GSD.
double coarse_x(const RefinementImage& fine, int column, int row) {
  double x = 0;
  int count = 0;
  for_each_child(fine.object, column, row, [&](int u, int v) {
    x += fine.x(u, v);
    ++count;
  });
  return x / count / 2;
}

/// What a coarse pixel's children say; its place is on the object and usable where one of theirs is.
PixelData coarse_pixel(const RefinementImage& fine, RefinementImage& coarse, int column, int row) {
  double x_prior = 0, sigma = 0;
  float s0 = 0, s1 = 0, s2 = 0, variance = 0;
  int count = 0, usable = 0, specular = 0;
  for_each_child(fine.object, column, row, [&](int u, int v) {
    const PixelData pixel = fine.source->at(u, v);
    x_prior += pixel.x_prior;
    sigma += pixel.prior_sigma;
    specular += fine.kind_at(u, v) == Reflection::specular;
    ++count;
    if (!fine.usable(u, v)) return;
    s0 += pixel.s0;
    s1 += pixel.s1;
    s2 += pixel.s2;
    variance += pixel.variance;
    ++usable;
  });
  if (count == 0) return {};
  coarse.object(column, row) = 255;
  coarse.kind(column, row) =
      static_cast<std::uint8_t>(2 * specular > count ? Reflection::specular : Reflection::diffuse);
  PixelData pixel;
  pixel.x_prior = x_prior / count / 2;
  pixel.prior_sigma = static_cast<float>(sigma / count / 2);
  if (usable == 0) return pixel;
  coarse.usable(column, row) = 255;
  const float share = 1.0F / static_cast<float>(usable);
  pixel.s0 = share * s0;
  pixel.s1 = share * s1;
  pixel.s2 = share * s2;
  pixel.variance = share * share * variance;
  return pixel;
}

}  // namespace

RefinementImage coarsened(const RefinementImage& fine, const Context& context) {
  RefinementImage coarse;
  coarse.camera = fine.camera.binned();
  coarse.focal = fine.focal / 2;
  coarse.log_depth_origin = fine.log_depth_origin;
  coarse.reflection = fine.reflection;
  coarse.shading = fine.shading;
  const Size size = coarse.camera.size;
  coarse.object = coarse.usable = Mask(size);
  coarse.x = Image<double>(size, 1, std::numeric_limits<double>::quiet_NaN());
  coarse.kind = Image<std::uint8_t>(size);
  auto pixels = std::make_shared<CoarsePixels>(size);
  parallel_rows(context, size.height, [&](int row) {
    for (int column = 0; column < size.width; ++column) {
      (*pixels)(column, row) = coarse_pixel(fine, coarse, column, row);
      if (coarse.object(column, row)) coarse.x(column, row) = coarse_x(fine, column, row);
    }
  });
  coarse.source = std::move(pixels);
  return coarse;
}

void take_over(RefinementImage& fine, const RefinementImage& coarse, const Context& context) {
  Image<double> change(coarse.size());
  parallel_rows(context, change.height(), [&](int row) {
    for (int column = 0; column < change.width(); ++column) {
      if (coarse.object(column, row)) change(column, row) = coarse.x(column, row) - coarse_x(fine, column, row);
    }
  });
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
        sum += weight * change(i, j);
        weights += weight;
      }
      fine.x(u, v) += 2 * sum / weights;  // the pixel's own coarse one is always there
    }
  });
  fine.reflection = coarse.reflection;
  fine.shading = coarse.shading;
}

}  // namespace malus
