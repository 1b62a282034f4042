#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "malus/core/median_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/stereo/highlights_internal.h"
#include "malus/stereo/intensity_pyramid_internal.h"
#include "malus/stereo/surface_raster_internal.h"
#include "malus/stereo/view_projection_internal.h"

namespace malus {
namespace {

constexpr std::size_t least_views = 3;
/// Added to intensities before ratios are formed: darker values depend on how the camera encodes black.
constexpr float black = 0.02F;
/// A highlight is brighter by this share of the object's median, and by `least_deviations` standard deviations of the
/// differences.
constexpr float least_excess = 0.12F, least_deviations = 6;

float bilinear(const Image<float>& image, float x, float y) {
  const int u = static_cast<int>(std::floor(x)), v = static_cast<int>(std::floor(y));
  if (u < 0 || v < 0 || u + 1 >= image.width() || v + 1 >= image.height()) return no_value;
  const float a = x - static_cast<float>(u), b = y - static_cast<float>(v);
  return (1 - b) * ((1 - a) * image(u, v) + a * image(u + 1, v)) +
         b * ((1 - a) * image(u, v + 1) + a * image(u + 1, v + 1));
}

float median_on(const Image<float>& values, const Mask& mask) {
  std::vector<float> known;
  for (std::size_t i = 0; i < values.count(); ++i) {
    if (mask[i] != 0 && std::isfinite(values[i])) known.push_back(values[i]);
  }
  return median_in_place(known);
}

/// ln of a photo's intensity over the station's at every second pixel, its median 0; NaN where the photo does not see
/// the surface. `photo` is at half its size.
Image<float> log_ratio(const Image<float>& station, const Mask& mask, const ViewProjection& projection,
                       const Image<float>& photo, const Image<float>& log_depth, const Context& context) {
  Image<float> ratio(mask.size(), 1, no_value);
  parallel_rows(context, mask.height(), [&](int v) {
    const auto count = static_cast<std::size_t>(mask.width());
    std::vector<float> z(count), x(count), y(count);
    for (std::size_t i = 0; i < count; ++i) z[i] = std::exp(log_depth(static_cast<int>(i), v));
    projection.project_row(0, v, 2, z.data(), count, x.data(), y.data());
    for (int u = 0; u < mask.width(); ++u) {
      const std::size_t i = static_cast<std::size_t>(u);
      if (mask(u, v) == 0 || !std::isfinite(z[i])) continue;
      ratio(u, v) = std::log((bilinear(photo, x[i] / 2, y[i] / 2) + black) / (station(u, v) + black));
    }
  });
  const float gain = median_on(ratio, mask);
  for (float& value : ratio) value -= gain;
  return ratio;
}

}  // namespace

Mask find_highlights(const Image<float>& reference, const Mask& object, const ViewChoice& photos,
                     const Image<float>& log_depth, int reach_px, const Context& context) {
  // A photo from behind shows another surface where this one would be.
  const std::vector<std::size_t> seeing = photos.seeing();
  if (seeing.size() < least_views) return Mask(object.size(), 1, 0);
  const OpenCvThreads opencv_threads(context.threads);
  // Half the resolution has less noise, and there a surface error of one pixel does not matter.
  const Image<float> station = halved(reference, context);
  const Mask mask = halved(object, context);
  const Image<float> surface = halved_surface(log_depth, mask, context);
  std::vector<Image<float>> ratios(seeing.size());
  parallel_for(context, seeing.size(), 1, [&](std::size_t k, std::size_t) {
    ratios[k] = log_ratio(station, mask, photos.projection(seeing[k]), photos.halved_photo(seeing[k], context), surface,
                          context);
  });

  Image<float> excess(mask.size(), 1, no_value);
  parallel_rows(context, mask.height(), [&](int v) {
    std::vector<float> values;
    for (int u = 0; u < mask.width(); ++u) {
      values.clear();
      for (const Image<float>& ratio : ratios) {
        if (std::isfinite(ratio(u, v))) values.push_back(ratio(u, v));
      }
      if (values.size() < least_views) continue;
      excess(u, v) = (station(u, v) + black) * (1 - std::exp(median_in_place(values)));
    }
  });
  Image<float> deviation = excess;
  const float usual = median_on(excess, mask);
  for (float& value : deviation) value = std::abs(value - usual);
  const float spread = static_cast<float>(deviation_per_median) * median_on(deviation, mask);
  const float threshold = std::max(least_excess * median_on(station, mask), least_deviations * spread);

  Mask shines(mask.size(), 1, 0);
  for (std::size_t i = 0; i < shines.count(); ++i) {
    if (mask[i] != 0 && excess[i] > threshold) shines[i] = 255;
  }
  const int width = 2 * ((reach_px + 1) / 2) + 1;
  cv::Mat region = as_mat(shines);
  cv::dilate(region, region, cv::getStructuringElement(cv::MORPH_RECT, {width, width}));
  Mask result(object.size(), 1, 0);
  parallel_pixels(context, result.size(), [&](int u, int v) { result(u, v) = shines(u / 2, v / 2); });
  return result;
}

}  // namespace malus
