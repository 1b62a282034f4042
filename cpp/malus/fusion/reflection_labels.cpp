
#include "malus/core/even_choice_internal.h"
#include "malus/core/masked_blur_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/fusion/connected_sets_internal.h"
#include "malus/fusion/reflection_labels_internal.h"

namespace malus {
namespace {

struct Evidence {
  Image<float> weight;    ///< sin² of the zenith; NaN where polarization may not be used
  Image<float> specular;  ///< the same where the pixel looks specular, else 0
};

Evidence collect_evidence(const RefinementField& field, const Context& context) {
  Evidence evidence{Image<float>(field.size(), 1, no_value), Image<float>(field.size(), 1, no_value)};
  parallel_pixels(context, field.usable, [&](int u, int v) {
    const Slopes slopes = central_slopes(field, u, v);
    const double p = slopes.p, q = slopes.q, tan2 = p * p + q * q;
    const double radial = field.s1(u, v) * (p * p - q * q) + field.s2(u, v) * 2 * p * q;
    evidence.weight(u, v) = static_cast<float>(tan2 / (1 + tan2));
    evidence.specular(u, v) = radial < 0 ? evidence.weight(u, v) : 0.0f;
  });
  return evidence;
}

/// Kind supported by nearly all evidence around a pixel, given the share of specular evidence; `outside` = neither.
Reflection clear_kind(float specular_share) {
  constexpr double clear = 0.9;
  if (specular_share > clear) return Reflection::specular;
  return specular_share < 1 - clear ? Reflection::diffuse : Reflection::outside;
}

}  // namespace

void label_reflection(RefinementImage& image, const std::vector<RowRange>& strips, const Context& context) {
  // Highlights, shadows and noise look like the other kind in places; a different material does so over a whole region.
  constexpr double pooling_px = 20;
  constexpr int reach_px = 64;  // reach of the pooling, in whole prior blocks
  constexpr std::size_t smallest_region_px = 4000;
  double specular = 0, all = 0;
  Image<Reflection> clear(image.size());
  for (const RowRange& rows : strips) {
    const StripField strip = strip_field(image, rows, reach_px, context);
    const RefinementField& field = strip.field;
    const Evidence evidence = collect_evidence(field, context);
    const Image<float> weights = masked_blur(evidence.weight, field.object, pooling_px, context);
    const Image<float> speculars = masked_blur(evidence.specular, field.object, pooling_px, context);
    for_each_pixel(PixelRect{0, strip.rows.begin, field.size().width, strip.rows.end}, [&](int u, int v) {
      if (evidence.weight(u, v) > 0) {
        all += evidence.weight(u, v);
        specular += evidence.specular(u, v);
      }
      if (field.object(u, v) && weights(u, v) > 0)
        clear(u, strip.first_row + v) = clear_kind(speculars(u, v) / weights(u, v));
    });
  }
  const bool mostly_specular = specular > 0.5 * all;
  const Reflection usual = mostly_specular ? Reflection::specular : Reflection::diffuse;
  const Reflection other = mostly_specular ? Reflection::diffuse : Reflection::specular;
  image.kind.fill(usual);
  Mask opposite(image.size());
  for (std::size_t i = 0; i < opposite.count(); ++i) opposite[i] = clear[i] == other ? 255 : 0;
  for (const PixelSet& region : connected_sets(opposite)) {
    if (region.size() < smallest_region_px) continue;
    for (const std::size_t pixel : region) image.kind[pixel] = other;
  }
}

double specular_share(const RefinementImage& image) {
  return mean_over(image.pixels, [&](int u, int v) { return image.kind(u, v) == Reflection::specular; });
}

bool is_mostly_specular(const RefinementImage& image) {
  constexpr double mirror_specular_share = 0.5;
  return specular_share(image) > mirror_specular_share;
}

}  // namespace malus
