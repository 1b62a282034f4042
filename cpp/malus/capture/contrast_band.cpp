#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>

#include "malus/capture/contrast_band_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/parallel_internal.h"

namespace malus {
namespace {

/// Number of rows processed together, so that intermediate results stay in a processor's cache.
constexpr int strip_rows = 64;
/// Variance [px²] of the blur by two steps of the pyramid (1, and 1 at twice the pixel size), and by a cubic B-spline
/// over four pixels.
constexpr double pyramid_variance = 1 + 4, spline_variance = 16.0 / 3;

void blur(const cv::Mat& image, double sigma_px, cv::Mat& blurred) {
  cv::GaussianBlur(image, blurred, {}, sigma_px, 0, cv::BORDER_REFLECT_101);
}

/// Remaining blur of the quarter image, in its pixels; negative if the full image must be blurred instead.
double sigma_of_quarter(double sigma_px) {
  const double variance = sigma_px * sigma_px - pyramid_variance - spline_variance;
  return variance > 4 ? std::sqrt(variance) / 4 : -1;
}

/// Rows of the quarter image enlarged four times by cubic B-splines. B-splines have the same second moments at every
/// position, as a blur does, so the result does not depend on the positions of the quarter image's samples.
class QuarterRows {
 public:
  explicit QuarterRows(const Image<float>& quarter)
      : quarter_(quarter), padded_(static_cast<std::size_t>(quarter.width()) + 4) {
    for (int p = 0; p < 4; ++p) {
      const float f = 0.25F * static_cast<float>(p), g = 1 - f;
      weights_[static_cast<std::size_t>(p)] = {g * g * g / 6, (4 - 6 * f * f + 3 * f * f * f) / 6,
                                               (4 - 6 * g * g + 3 * g * g * g) / 6, f * f * f / 6};
    }
  }

  void row(int v, int width, float* values) {
    const std::array<float, 4>& w = weights_[static_cast<std::size_t>(v % 4)];
    const auto at = [&](int offset) { return quarter_.row(std::clamp(v / 4 + offset, 0, quarter_.height() - 1)); };
    const float *const r0 = at(-1), *const r1 = at(0), *const r2 = at(1), *const r3 = at(2);
    float* const column = padded_.data() + 1;
    const int columns = quarter_.width();
    for (int i = 0; i < columns; ++i) column[i] = w[0] * r0[i] + w[1] * r1[i] + w[2] * r2[i] + w[3] * r3[i];
    column[-1] = column[0];
    std::fill_n(column + columns, 3, column[columns - 1]);
    const auto value = [&](int i, std::size_t p) {
      const float* const c = column + i - 1;
      return weights_[p][0] * c[0] + weights_[p][1] * c[1] + weights_[p][2] * c[2] + weights_[p][3] * c[3];
    };
    const int whole = width / 4;
    for (int i = 0; i < whole; ++i) {
      for (std::size_t p = 0; p < 4; ++p) values[4 * i + static_cast<int>(p)] = value(i, p);
    }
    for (int u = 4 * whole; u < width; ++u) values[u] = value(whole, static_cast<std::size_t>(u % 4));
  }

 private:
  const Image<float>& quarter_;
  std::array<std::array<float, 4>, 4> weights_;  ///< of the samples, for each quarter of a sample
  std::vector<float> padded_;
};

}  // namespace

ContrastBands contrast_bands(const std::vector<Image<float>>& images, const std::vector<Image<float>>& quarters,
                             const BandScales& scales, const NoiseModel& noise, const Context& context) {
  const Size size = images[0].size();
  const double left_sigma_px = quarters.empty() ? -1 : sigma_of_quarter(scales.coarse_sigma_px);
  std::vector<Image<float>> coarse(left_sigma_px > 0 ? images.size() : 0);
  parallel_for(context, coarse.size(), 1, [&](std::size_t k, std::size_t) {
    coarse[k] = Image<float>(quarters[k].size());
    cv::Mat blurred = as_mat(coarse[k]);
    blur(as_mat(quarters[k]), left_sigma_px, blurred);
  });

  ContrastBands result;
  for (std::size_t k = 0; k < images.size(); ++k) result.bands.push_back(Image<float>::uninitialized(size));
  result.information = Image<float>::uninitialized(size);
  const auto floor = static_cast<float>(std::max(3 * std::sqrt(noise.variance(0)), 1e-6));
  const double blur_gain = 1 / (4 * std::numbers::pi * scales.fine_sigma_px * scales.fine_sigma_px);
  const auto offset = static_cast<float>(blur_gain * noise.variance(0));
  const auto slope = static_cast<float>(blur_gain * (noise.variance(1) - noise.variance(0)));
  const auto strips = static_cast<std::size_t>((size.height + strip_rows - 1) / strip_rows);
  parallel_for(context, images.size() * strips, 1, [&](std::size_t part, std::size_t) {
    const std::size_t k = part / strips;
    const int v0 = static_cast<int>(part % strips) * strip_rows, v1 = std::min(v0 + strip_rows, size.height);
    // Blurring a range of rows uses the image's rows above and below it.
    cv::Mat fine = as_mat(result.bands[k]).rowRange(v0, v1), mean;
    const cv::Mat source = as_mat(images[k]).rowRange(v0, v1);
    blur(source, scales.fine_sigma_px, fine);
    if (coarse.empty()) {
      blur(source, scales.coarse_sigma_px, mean);
    } else {
      mean.create(v1 - v0, size.width, CV_32F);
      QuarterRows rows(coarse[k]);
      for (int v = v0; v < v1; ++v) rows.row(v, size.width, mean.ptr<float>(v - v0));
    }
    for (int v = v0; v < v1; ++v) {
      const float* const means = mean.ptr<float>(v - v0);
      float *const band = result.bands[k].row(v), *const information = result.information.row(v);
      for (int u = 0; u < size.width; ++u) band[u] = (band[u] - means[u]) / std::max(means[u], floor);
      if (k > 0) continue;
      for (int u = 0; u < size.width; ++u) {
        const float bright = std::max(means[u], floor);
        information[u] = bright * bright / std::max(offset + slope * bright, 1e-14F);
      }
    }
  });
  return result;
}

}  // namespace malus
