#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "malus/capture/resampling_internal.h"
#include "malus/capture/spline_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/core/parallel_internal.h"

namespace malus {
namespace {

/// Top-left sample of the spline's support and the fraction within; nothing unless the support lies in the raster. A
/// position on the last possible row or column needs no sample beyond it, so the support is shifted inwards there.
struct Support {
  int u, v;
  double fu, fv;
};

std::optional<Support> support_at(const Eigen::Vector2d& position, Size size) {
  constexpr int before = spline_support / 2 - 1, after = spline_support / 2;
  if (std::min(size.width, size.height) < spline_support) return std::nullopt;
  if (!(position.x() >= before && position.y() >= before && position.x() <= size.width - after &&
        position.y() <= size.height - after)) {
    return std::nullopt;
  }
  const int u = std::min(static_cast<int>(position.x()), size.width - 1 - after);
  const int v = std::min(static_cast<int>(position.y()), size.height - 1 - after);
  return Support{u - before, v - before, position.x() - u, position.y() - v};
}

/// Values of all channels of the spline with these coefficients.
void spline_values(const Image<float>& coefficients, const Support& support, float* values) {
  const auto wu = spline_weights(support.fu), wv = spline_weights(support.fv);
  const int channels = coefficients.channels();
  for (int c = 0; c < channels; ++c) {
    float columns[spline_support] = {};
    for (int j = 0; j < spline_support; ++j) {
      const float* const row = coefficients.row(support.v + j) + static_cast<std::ptrdiff_t>(support.u) * channels + c;
      for (int i = 0; i < spline_support; ++i) columns[i] += wv[static_cast<std::size_t>(j)] * row[i * channels];
    }
    values[c] = std::inner_product(wu.begin(), wu.end(), columns, 0.0F);
  }
}

/// Fills what is not finite with the nearest finite value, so that the spline has no step there; returns where it was.
Mask filled_holes(Image<float>& image) {
  Mask holes(image.size());
  std::transform(image.begin(), image.end(), holes.begin(),
                 [](float value) -> std::uint8_t { return std::isfinite(value) ? 0 : 255; });
  const auto count = static_cast<std::size_t>(std::ranges::count(holes, std::uint8_t{255}));
  if (count == 0) return holes;
  if (count == image.count()) {
    image.fill(0);
    return holes;
  }
  const OpenCvThreads one_thread(1);
  cv::Mat distances, nearest;  // labels of the finite pixels, and of the one nearest to each hole
  cv::distanceTransform(as_mat(holes), distances, nearest, cv::DIST_L2, cv::DIST_MASK_5, cv::DIST_LABEL_PIXEL);
  const int* const label = nearest.ptr<int>();
  std::vector<float> values(image.count() - count + 1);
  for (std::size_t i = 0; i < image.count(); ++i)
    if (!holes[i]) values[static_cast<std::size_t>(label[i])] = image[i];
  for (std::size_t i = 0; i < image.count(); ++i)
    if (holes[i]) image[i] = values[static_cast<std::size_t>(label[i])];
  return holes;
}

}  // namespace

ResamplingMap::ResamplingMap(const std::optional<LensCamera>& lens, const Affine& image_from_base)
    : image_from_base_(image_from_base) {
  if (lens && lens->has_distortion()) {
    lens_ = lens;
    raster_ = lens->pinhole();
  }
  identity_ = !lens_ && image_from_base_ == identity_affine();
}

Eigen::Vector2d ResamplingMap::operator()(int u, int v) const {
  Eigen::Vector2d base(u, v);
  if (lens_) base = lens_->distort(raster_.ray(u, v).head<2>());
  return image_from_base_.leftCols<2>() * base + image_from_base_.col(2);
}

Resampled resample(Image<float> image, Size size, const ResamplingMap& map, const Context& context) {
  if (map.is_identity() && image.size() == size) return {std::move(image), Mask(size, 1, 255)};
  to_spline_coefficients(image, context);
  Resampled result{Image<float>::uninitialized(size, image.channels()), Mask::uninitialized(size)};
  parallel_pixels(context, size, [&](int u, int v) {
    float* const values = &result.image(u, v);
    const auto support = support_at(map(u, v), image.size());
    result.valid(u, v) = support ? 255 : 0;
    if (support) {
      spline_values(image, *support, values);
    } else {
      std::fill_n(values, image.channels(), no_value);
    }
  });
  return result;
}

Mask resample_flags(const Mask& flags, Size size, const ResamplingMap& map, const Context& context) {
  if (map.is_identity() && flags.size() == size) return flags;
  auto result = Mask::uninitialized(size);
  parallel_pixels(context, size, [&](int u, int v) {
    const auto support = support_at(map(u, v), flags.size());
    std::uint8_t any = 0;
    for (int j = 0; support && j < spline_support; ++j) {
      const std::uint8_t* row = flags.row(support->v + j) + support->u;
      any |= row[0] | row[1] | row[2] | row[3];
    }
    result(u, v) = any != 0 ? 255 : 0;
  });
  return result;
}

Image<float> undistorted(Image<float> image, const LensCamera& lens, const Context& context) {
  const Mask holes = filled_holes(image);
  const ResamplingMap map(lens, identity_affine());
  Image<float> result = resample(std::move(image), lens.size, map, context).image;
  const Mask unknown = resample_flags(holes, lens.size, map, context);
  for (std::size_t i = 0; i < result.count(); ++i) {
    if (unknown[i]) result[i] = no_value;
  }
  return result;
}

}  // namespace malus
