#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "malus/core/median_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/evidence/smoothing_internal.h"

namespace malus {
namespace {

constexpr double clip_sigmas = 4;

}  // namespace

void smooth(Image<float>& image, double sigma_px) {
  cv::Mat mat = as_mat(image);
  cv::GaussianBlur(mat, mat, cv::Size(), sigma_px, sigma_px, cv::BORDER_CONSTANT);
}

Image<float> band_inside(const Image<float>& image, const Mask& mask, double fine_px, double coarse_px) {
  Image<float> fine(image.size(), 2);
  for (std::size_t i = 0; i < mask.count(); ++i) {
    const bool inside = mask[i] != 0 && std::isfinite(image[i]);
    fine[2 * i] = inside ? image[i] : 0.0F;
    fine[2 * i + 1] = inside ? 1.0F : 0.0F;
  }
  const Image<float> inside = fine;
  Image<float> coarse = fine;
  smooth(fine, fine_px);
  smooth(coarse, coarse_px);
  Image<float> band(image.size());
  std::vector<float> sizes;
  for (std::size_t i = 0; i < mask.count(); ++i) {
    if (inside[2 * i + 1] == 0) continue;
    band[i] = fine[2 * i] / fine[2 * i + 1] - coarse[2 * i] / coarse[2 * i + 1];
    sizes.push_back(std::abs(band[i]));
  }
  const float limit = static_cast<float>(clip_sigmas * deviation_per_median) * median_in_place(sizes);
  for (float& value : band) value = std::clamp(value, -limit, limit);
  return band;
}

}  // namespace malus
