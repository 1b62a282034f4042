#include <algorithm>
#include <string>

#include "malus/core/error.h"
#include "malus/core/even_choice_internal.h"
#include "malus/evidence/pixel_samples_internal.h"

namespace malus {
namespace {

constexpr double most_samples = 200000;
/// With many images there are fewer samples, so that they take no more memory than this many values.
constexpr double most_values = 2e7;
/// Of a small object in a large image, at least this share of the wanted samples is taken, or all of its pixels.
constexpr double least_on_object = 0.02;
constexpr float darkest_sample = 0.02F, brightest_sample = 0.9F;

/// Adds a pixel's values to the window's. Returns false if the pixel is off the mask, dark or nearly saturated.
bool add_pixel(const std::vector<Image<float>>& images, const Mask& mask, int u, int v, Eigen::VectorXd& sum) {
  if (!mask.empty() && mask(u, v) == 0) return false;
  for (std::size_t k = 0; k < images.size(); ++k) {
    const float value = images[k](u, v);
    if (!(value > darkest_sample && value < brightest_sample)) return false;
    sum[static_cast<Eigen::Index>(k)] += value;
  }
  return true;
}

}  // namespace

PixelSamples pixel_samples(const std::vector<Image<float>>& images, const std::vector<double>& angles_rad,
                           const Mask& mask, int reach_px, const Context& context) {
  if (images.empty() || images.size() != angles_rad.size()) {
    throw input_error(std::to_string(images.size()) + " images and " + std::to_string(angles_rad.size()) +
                      " angles, expected one angle per image");
  }
  PixelSamples samples;
  const Size size = images.front().size();
  const double wanted = std::min(most_samples, most_values / static_cast<double>(images.size()));
  const int stride = stride_on(mask, size, wanted, least_on_object * wanted);
  const int side = 2 * reach_px + 1;
  for (int v = reach_px; v < size.height - reach_px; v += stride) {
    context.check_cancel();
    for (int u = reach_px; u < size.width - reach_px; u += stride) {
      Eigen::VectorXd sum = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(images.size()));
      bool counts = true;
      for (int i = 0; i < side * side && counts; ++i)
        counts = add_pixel(images, mask, u - reach_px + i % side, v - reach_px + i / side, sum);
      if (!counts) continue;
      samples.values.push_back(sum / (side * side));
      samples.parts.push_back(8 * v / size.height * 8 + 8 * u / size.width);
    }
  }
  return samples;
}

}  // namespace malus
