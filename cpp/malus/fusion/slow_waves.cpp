#include "malus/core/masked_blur_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/square_internal.h"
#include "malus/fusion/anchor_internal.h"
#include "malus/fusion/slow_waves_internal.h"

namespace malus {

void shrink_slow_waves(RefinementImage& image, const Image<double>& x_prior, double smoothing_px,
                       const Context& context) {
  constexpr double around = 2;  // mean squares of a place are taken over so many of its waves' lengths
  const double wave_px = waves_of_prior * smoothing_px;
  Image<float> slow(image.size()), squares(image.size());
  parallel_pixels(context, image.object,
                  [&](int u, int v) { slow(u, v) = static_cast<float>(image.x(u, v) - x_prior(u, v)); });
  slow = masked_blur(slow, image.object, wave_px, context);
  parallel_pixels(context, image.object, [&](int u, int v) {
    squares(u, v) = static_cast<float>(square(slow(u, v) / image.source(u, v).prior_sigma));
  });
  squares = masked_blur(squares, image.object, around * wave_px, context);
  parallel_pixels(context, image.object, [&](int u, int v) {
    if (squares(u, v) > 1) image.x(u, v) -= (1 - 1 / static_cast<double>(squares(u, v))) * slow(u, v);
  });
}

}  // namespace malus
