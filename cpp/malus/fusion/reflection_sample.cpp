#include <cmath>

#include "malus/core/even_choice_internal.h"
#include "malus/fusion/fresnel_factors_internal.h"
#include "malus/fusion/reflection_sample_internal.h"

namespace malus {

ReflectionSample sample_of(const PixelData& pixel, const Slopes& slopes, const RayFrame& frame) {
  constexpr double model_error = 0.003;  // of s0: error of any forward model
  const double s0 = pixel.s0;
  return {slopes, s0, pixel.s1, pixel.s2, std::sqrt(pixel.variance + model_error * model_error * s0 * s0), frame};
}

std::vector<ReflectionSample> collect_samples(const RefinementImage& image, Reflection kind,
                                              std::size_t largest_count) {
  constexpr double largest_tan2 = 6;  // steeper slopes, at the rim, are too uncertain
  Mask of_kind(image.size());
  for (std::size_t i = 0; i < of_kind.count(); ++i) of_kind[i] = image.usable[i] && image.kind[i] == kind ? 255 : 0;
  std::vector<ReflectionSample> samples;
  for_each_chosen(of_kind, static_cast<double>(largest_count), [&](int u, int v) {
    const Slopes slopes = central_slopes(image, u, v);
    if (slopes.tan2() > largest_tan2) return;
    samples.push_back(sample_of(image.source(u, v), slopes, image.frame_at(u, v)));
    samples.back().other_finish = image.has_other_finish(u, v);
  });
  return samples;
}

double error_of_slopes(const ReflectionSample& s, Reflection kind) {
  constexpr double slope_error = 0.03, usual_index = 1.5;
  const FresnelFactors f = fresnel_factors(s.slopes.tan2(), usual_index);
  const double degree = kind == Reflection::specular ? f.specular / f.reflectance : f.diffuse;
  return slope_error * s.s0 * std::abs(degree) * 2 * std::sqrt(s.slopes.tan2());
}

}  // namespace malus
