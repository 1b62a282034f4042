#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "capture/scenes.h"
#include "malus/capture/contrast_band_internal.h"

namespace malus {
namespace {

constexpr Size odd_size{301, 222};

Image<float> half_size(const Image<float>& image) {
  Image<float> half({(image.width() + 1) / 2, (image.height() + 1) / 2});
  cv::Mat out(half.height(), half.width(), CV_32F, half.data());
  cv::pyrDown(cv::Mat(image.height(), image.width(), CV_32F, const_cast<float*>(image.data())), out, out.size());
  return half;
}

TEST(ContrastBand, a_given_quarter_size_image_gives_the_same_band) {
  const std::vector<Image<float>> images{AnalyticScene{}.image(odd_size, identity_affine(), 0)};
  const std::vector<Image<float>> quarters{half_size(half_size(images[0]))};
  const ContrastBands direct = contrast_bands(images, {}, {0.7, 8}, NoiseModel{}, Context{}),
                      quick = contrast_bands(images, quarters, {0.7, 8}, NoiseModel{}, two_threads());
  double largest = 0, difference = 0;
  // Near the border the two differ, because each extends the image in its own way.
  for (int v = 30; v < odd_size.height - 30; ++v) {
    for (int u = 30; u < odd_size.width - 30; ++u) {
      largest = std::max<double>(largest, std::abs(direct.bands[0](u, v)));
      difference = std::max<double>(difference, std::abs(direct.bands[0](u, v) - quick.bands[0](u, v)));
      EXPECT_NEAR(quick.information(u, v) / direct.information(u, v), 1, 0.02);
    }
  }
  EXPECT_GT(largest, 0.2);
  EXPECT_LT(difference, 0.01 * largest);
}

TEST(ContrastBand, bands_in_strips_equal_those_of_the_whole_image) {
  const std::vector<Image<float>> images{AnalyticScene{}.image(odd_size, identity_affine(), 0)};
  const ContrastBands bands = contrast_bands(images, {}, {0.7, 3}, NoiseModel{}, two_threads());
  const cv::Mat whole(odd_size.height, odd_size.width, CV_32F, const_cast<float*>(images[0].data()));
  cv::Mat fine, coarse;
  cv::GaussianBlur(whole, fine, {}, 0.7, 0, cv::BORDER_REFLECT_101);
  cv::GaussianBlur(whole, coarse, {}, 3, 0, cv::BORDER_REFLECT_101);
  for (int v = 0; v < odd_size.height; ++v) {
    for (int u = 0; u < odd_size.width; ++u) {
      const float mean = coarse.at<float>(v, u);
      EXPECT_NEAR(bands.bands[0](u, v), (fine.at<float>(v, u) - mean) / mean, 1e-6);
    }
  }
}

}  // namespace
}  // namespace malus
