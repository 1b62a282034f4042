#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <string_view>

#include "malus/capture/mosaic_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/core/parallel_internal.h"

namespace malus {
namespace {

/// Smoothing of contrasts, and how often contrasts and mean are recomputed from each other.
struct Smoothing {
  int rounds;
  double sigma_px;
  /// Pixels that share a measurement: the area of the smoothed bilinear interpolation's correlation, 4π σ².
  double shared() const { return 4 * std::numbers::pi * (sigma_px * sigma_px + 2.0 / 3); }
};
/// `fine` where polarization varies as fast as brightness, `coarse` where texture is far stronger than polarization.
constexpr Smoothing fine{2, 0.7}, coarse{8, 2.0};
/// Variance of texture over squared degree of polarization above which the coarse contrasts have the larger weight.
constexpr float strong_texture = 30;
/// Texture is what a Gaussian of `texture_px` removes; its strength is averaged over a wider Gaussian.
constexpr double texture_px = 1, around_px = 3;
/// Rounds and smoothing for colors, which vary less than polarization does.
constexpr int color_rounds = 3;
constexpr double color_smoothing_px = 2;
constexpr float smallest_ratio = 0.02f;
/// Smallest divisor of ratios; below this intensity ratios would be noise only.
constexpr float dark = 1e-3f;
/// Difference in brightness, as a logarithm, from which cells have other color filters; and the share of it up to which
/// two cells have the same.
constexpr double other_colors = 0.1, alike_colors = 0.25;

/// Weights of a Gaussian, cut at three standard deviations.
cv::Mat gaussian_kernel(double sigma) {
  return cv::getGaussianKernel(2 * static_cast<int>(std::ceil(3 * sigma)) + 1, sigma, CV_32F);
}

/// The raster convolved with the same kernel along both axes, mirrored at the border (without repeating it, so that a
/// pixel keeps its place in the cell).
Image<float> convolve(const Image<float>& source, const cv::Mat& kernel) {
  const OpenCvThreads one_thread(1);  // called from threads of our own
  auto result = Image<float>::uninitialized(source.size());
  cv::sepFilter2D(as_mat(source), as_mat(result), CV_32F, kernel, kernel, {-1, -1}, 0, cv::BORDER_REFLECT_101);
  return result;
}

/// Place of a pixel in its 2 × 2 cell, by rows.
std::size_t cell_of(int u, int v) {
  return static_cast<std::size_t>(2 * (v % 2) + u % 2);
}

/// Bilinear interpolation of `value(u, v)`, sampled at the pixels of one place in the cell.
template <class Value>
Image<float> interpolate(Size size, std::size_t place, const Value& value) {
  Image<float> samples(size);
  for (int v = static_cast<int>(place) / 2; v < size.height; v += 2) {
    for (int u = static_cast<int>(place) % 2; u < size.width; u += 2) samples(u, v) = value(u, v);
  }
  return convolve(samples, cv::Mat(cv::Matx31f(0.5f, 1.0f, 0.5f)));
}

/// Color filter over a pixel.
char color_at(BayerPattern colors, int u, int v) {
  return enum_name(colors)[cell_of(u / 2, v / 2)];
}

/// Throws an input error unless a mosaic has one channel and consists of whole cells of this side, `described` in
/// words.
void require_cells(const Image<float>& mosaic, int side, const std::string& described, const std::string& name) {
  const Size size = mosaic.size();
  if (mosaic.channels() != 1) throw input_error(name + ": a polarization mosaic has one channel, this image has 3");
  if (size.width % side != 0 || size.height % side != 0 || size.width < 8 || size.height < 8)
    throw input_error(name + " is " + to_string(size) + " pixels; " + described);
}

void require_color_cells(const Image<float>& mosaic, const std::string& name) {
  require_cells(mosaic, 4, "a color mosaic of 4 x 4 cells has a width and height that are multiples of 4, at least 8",
                name);
}

/// Ratio of one color's samples to their expected values without color, smoothed and interpolated to all pixels. The
/// mean weights a cell's four polarizers equally, so that their differences cancel.
Image<float> color_ratio(const Image<float>& mosaic, const Image<float>& expected, BayerPattern colors, char color,
                         const cv::Mat& cells) {
  const Size size = mosaic.size();
  Image<float> ratios(size), weights(size);
  for_each_pixel(size, [&](int u, int v) {
    if (color_at(colors, u, v) != color) return;
    ratios(u, v) = mosaic(u, v) / std::max(expected(u, v), dark);
    weights(u, v) = 1;
  });
  const cv::Mat kernel = gaussian_kernel(color_smoothing_px);
  ratios = convolve(convolve(ratios, cells), kernel);
  weights = convolve(convolve(weights, cells), kernel);
  for (std::size_t i = 0; i < ratios.count(); ++i) ratios[i] /= weights[i];
  return ratios;
}

/// Each polarizer's contrast relative to the mean over the polarizers, and that mean.
struct Contrasts {
  std::array<Image<float>, 4> of_polarizer;
  Image<float> mean;
};

Contrasts contrasts(const Image<float>& mosaic, const Smoothing& smoothing, const Context& context) {
  const Size size = mosaic.size();
  Contrasts result{.of_polarizer = {}, .mean = Image<float>(size)};
  Image<float>& mean = result.mean;
  for (std::size_t p = 0; p < 4; ++p) {
    const Image<float> bilinear = interpolate(size, p, [&](int u, int v) { return mosaic(u, v); });
    for (std::size_t i = 0; i < mean.count(); ++i) mean[i] += 0.25f * bilinear[i];
  }
  const cv::Mat kernel = gaussian_kernel(smoothing.sigma_px);
  for (int round = 0; round < smoothing.rounds; ++round) {
    parallel_for(context, 4, 1, [&](std::size_t p, std::size_t) {
      const auto contrast = [&](int u, int v) {
        // No polarizer lets more through than twice the mean: 0 to s0.
        return std::clamp((mosaic(u, v) - mean(u, v)) / std::max(mean(u, v), dark), -1.0f, 1.0f);
      };
      result.of_polarizer[p] = convolve(interpolate(size, p, contrast), kernel);
    });
    parallel_pixels(context, size, [&](int u, int v) {
      float sum = 0;
      for (const Image<float>& channel : result.of_polarizer) sum += channel(u, v);
      for (Image<float>& channel : result.of_polarizer) {
        channel(u, v) = std::max(channel(u, v) - sum / 4, -0.95f);
      }
      mean(u, v) = mosaic(u, v) / (1 + result.of_polarizer[cell_of(u, v)](u, v));
    });
  }
  return result;
}

/// Weight of the fine contrasts at every pixel, 0 … 1. It is small where texture is so much stronger than polarization
/// that the fine contrasts mainly show residual texture.
Image<float> share_of_fine(const Contrasts& smooth) {
  const Size size = smooth.mean.size();
  const Image<float> around = convolve(smooth.mean, gaussian_kernel(texture_px));
  Image<float> texture(size), degree(size);
  for (std::size_t i = 0; i < texture.count(); ++i) {
    const float relative = smooth.mean[i] / std::max(around[i], dark) - 1;
    texture[i] = relative * relative;
    for (const Image<float>& channel : smooth.of_polarizer) degree[i] += 0.5f * channel[i] * channel[i];
  }
  texture = convolve(texture, gaussian_kernel(around_px));
  degree = convolve(degree, gaussian_kernel(around_px));
  Image<float> share(size);
  for (std::size_t i = 0; i < share.count(); ++i) {
    const float ratio = texture[i] / (strong_texture * std::max(degree[i], 1e-8f));
    share[i] = 1 / (1 + ratio * ratio);
  }
  return share;
}

}  // namespace

MosaicSplit demosaic(const Image<float>& mosaic, const std::string& name, const Context& context) {
  const Size size = mosaic.size();
  require_cells(mosaic, 2, "a mosaic of 2 x 2 cells has an even width and height of at least 8", name);
  const Contrasts smooth = contrasts(mosaic, coarse, context);
  Contrasts sharp = contrasts(mosaic, fine, context);
  const Image<float> share = share_of_fine(smooth);
  MosaicSplit result{.channels = std::move(sharp.of_polarizer), .shared = Image<float>(size)};
  parallel_pixels(context, size, [&](int u, int v) {
    const float weight = share(u, v);
    for (std::size_t p = 0; p < 4; ++p) {
      float& contrast = result.channels[p](u, v);
      contrast = weight * contrast + (1 - weight) * smooth.of_polarizer[p](u, v);
    }
    const float mean = mosaic(u, v) / (1 + result.channels[cell_of(u, v)](u, v));
    for (Image<float>& channel : result.channels) channel(u, v) = mean * (1 + channel(u, v));
    result.shared(u, v) = static_cast<float>(weight * fine.shared() + (1 - weight) * coarse.shared());
  });
  return result;
}

std::array<Image<float>, 3> split_colors(const Image<float>& mosaic, BayerPattern colors, const std::string& name,
                                         const Context& context) {
  require_color_cells(mosaic, name);
  const Size size = mosaic.size();
  std::array<Image<float>, 3> result;
  for (std::size_t c = 0; c < 3; ++c) {
    const char letter = "RGB"[c];
    Image<float>& plane = result[c];
    plane = Image<float>(size);
    parallel_pixels(context, size, [&](int u, int v) {
      if (color_at(colors, u, v) == letter) {
        plane(u, v) = mosaic(u, v);
        return;
      }
      // Samples of the same polarizer are two pixels apart.
      float sum = 0, weight = 0;
      for (int j = -2; j <= 2; j += 2) {
        for (int i = -2; i <= 2; i += 2) {
          if (!mosaic.contains(u + i, v + j) || color_at(colors, u + i, v + j) != letter) continue;
          const float use = i == 0 || j == 0 ? 2.0f : 1.0f;
          sum += use * mosaic(u + i, v + j);
          weight += use;
        }
      }
      plane(u, v) = sum / weight;
    });
  }
  return result;
}

ColorMosaic demosaic_color(const Image<float>& mosaic, BayerPattern colors, const std::string& name,
                           const Context& context) {
  require_color_cells(mosaic, name);
  const Size size = mosaic.size();
  // Each of the four positions modulo 4 has the same total weight: a mean over whole cells of 4 x 4.
  const cv::Mat cells(cv::Matx<float, 5, 1>(0.125f, 0.25f, 0.25f, 0.25f, 0.125f));
  ColorMosaic result;
  Image<float> expected = convolve(mosaic, cells);
  for (int round = 0; round < color_rounds; ++round) {
    for (std::size_t c = 0; c < 3; ++c) {
      result.ratios[c] = color_ratio(mosaic, expected, colors, "RGB"[c], cells);
    }
    Image<float> gray(size);
    parallel_pixels(context, size, [&](int u, int v) {
      const std::size_t c = std::string_view("RGB").find(color_at(colors, u, v));
      gray(u, v) = mosaic(u, v) / std::max(result.ratios[c](u, v), smallest_ratio);
    });
    result.gray = demosaic(gray, name, context);
    parallel_pixels(context, size, [&](int u, int v) { expected(u, v) = result.gray.channels[cell_of(u, v)](u, v); });
  }
  return result;
}

std::string doubt_of_colors(const Image<float>& mosaic, std::optional<BayerPattern> stated, const std::string& name) {
  // All four polarizers of a cell have the same color, and so do the cells of every second column and row.
  std::array<double, 4> sums{}, counts{};
  for_each_pixel(mosaic.size(), [&](int u, int v) {
    const std::size_t place = cell_of(u / 2, v / 2);
    sums[place] += mosaic(u, v);
    counts[place] += 1;
  });
  for (std::size_t i = 0; i < 4; ++i) sums[i] /= counts[i];
  const auto [least, most] = std::ranges::minmax(sums);
  if (!(least > 0)) return {};
  const auto differ_by = [&](std::size_t a, std::size_t b) { return std::abs(std::log(sums[a] / sums[b])); };
  // Two cells in opposite corners are green, and equally bright.
  const bool falling = differ_by(0, 3) < alike_colors * std::log(most / least),
             rising = differ_by(1, 2) < alike_colors * std::log(most / least);
  if (std::log(most / least) < other_colors || !(falling || rising)) return {};
  const std::string pattern =
      ": its cells of 2 x 2 pixels differ in brightness as behind the filters of a color camera";
  if (!stated) return name + pattern + "; is mosaic_colors missing?";
  if ((falling && rising) || enum_name(*stated)[falling ? 0 : 1] == 'G') return {};
  return name + pattern + ", but with green where mosaic_colors = \"" + std::string(enum_name(*stated)) +
         "\" has none; is it " + (falling ? "\"GRBG\" or \"GBRG\"?" : "\"RGGB\" or \"BGGR\"?");
}

Mask spread_flags(const Mask& flags, int reach) {
  const OpenCvThreads one_thread(1);  // like other functions without a Context
  Mask result(flags.size());
  cv::dilate(as_mat(flags), as_mat(result), cv::Mat::ones(2 * reach + 1, 2 * reach + 1, CV_8U));
  return result;
}

}  // namespace malus
