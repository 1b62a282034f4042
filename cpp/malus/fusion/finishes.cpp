#include <cmath>

#include "malus/core/masked_blur_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/square_internal.h"
#include "malus/fusion/finishes_internal.h"
#include "malus/fusion/reflection_sample_internal.h"

namespace malus {
namespace {

/// Robust cost of a pixel's polarization with the usual finish minus that with the other one.
double gain_of_other_finish(const RefinementImage& image, int u, int v) {
  const Slopes slopes = central_slopes(image, u, v);
  const RayFrame frame = image.frame_at(u, v);
  const ReflectionSample sample = sample_of(image.source(u, v), slopes, frame);
  const double variance = square(sample.sigma) + square(error_of_slopes(sample, Reflection::diffuse));
  const auto cost = [&](bool other) {
    const PixelReflection pixel(image.reflection, Reflection::diffuse, sample.s0, 0, frame, other);
    const PredictedStokes m = pixel.predict(slopes.p, slopes.q);
    return std::log1p((square(sample.s1 - m.s1) + square(sample.s2 - m.s2)) / (4 * variance));
  };
  return cost(false) - cost(true);
}

}  // namespace

Mask pixels_of_other_finish(const RefinementImage& image, const Context& context) {
  // The mean over neighbors keeps noise and wrong slopes of single pixels from looking like a finish.
  constexpr double neighbors_px = 4, clearly = 0.1;
  Image<float> gain(image.size(), 1, no_value);
  parallel_pixels(context, image.usable,
                  [&](int u, int v) { gain(u, v) = static_cast<float>(gain_of_other_finish(image, u, v)); });
  const Image<float> mean = masked_blur(gain, image.pixels, neighbors_px, context);
  Mask other(image.size());
  for (std::size_t i = 0; i < other.count(); ++i) other[i] = image.pixels[i] && mean[i] > clearly ? 255 : 0;
  return other;
}

}  // namespace malus
