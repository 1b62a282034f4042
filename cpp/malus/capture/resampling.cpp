#include <cmath>
#include <limits>

#include "malus/capture/resampling_internal.h"
#include "malus/core/parallel_internal.h"

namespace malus {
namespace {

/// Top-left sample of the 4 × 4 support and the fraction within; nothing unless the support lies in the raster. A
/// position on the last row or column needs no sample beyond it, so the support is shifted inwards there.
struct Support {
  int u, v;
  double fu, fv;
};

std::optional<Support> support_at(const Eigen::Vector2d& position, Size size) {
  if (!(position.x() >= 1 && position.y() >= 1 && position.x() <= size.width - 2 && position.y() <= size.height - 2)) {
    return std::nullopt;
  }
  const int u = std::min(static_cast<int>(position.x()), size.width - 3);
  const int v = std::min(static_cast<int>(position.y()), size.height - 3);
  return Support{u - 1, v - 1, position.x() - u, position.y() - v};
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

Eigen::Vector4d bicubic_weights(double fraction, Interpolation interpolation) {
  const double a = interpolation == Interpolation::bicubic ? -0.75 : -0.5;
  const auto near = [a](double x) { return ((a + 2) * x - (a + 3)) * x * x + 1; };
  const auto far = [a](double x) { return ((a * x - 5 * a) * x + 8 * a) * x - 4 * a; };
  return {far(1 + fraction), near(fraction), near(1 - fraction), far(2 - fraction)};
}

Resampled resample(const Image<float>& source, Size size, const ResamplingMap& map, Interpolation interpolation,
                   const Context& context) {
  if (map.is_identity() && source.size() == size) return {source, Mask(size, 1, 255)};
  const int channels = source.channels();
  Resampled result{Image<float>::uninitialized(size, channels), Mask::uninitialized(size)};
  parallel_pixels(context, size, [&](int u, int v) {
    const auto support = support_at(map(u, v), source.size());
    result.valid(u, v) = support ? 255 : 0;
    if (!support) {
      for (int c = 0; c < channels; ++c) result.image(u, v, c) = std::numeric_limits<float>::quiet_NaN();
      return;
    }
    const Eigen::Vector4d wu = bicubic_weights(support->fu, interpolation);
    const Eigen::Vector4d wv = bicubic_weights(support->fv, interpolation);
    for (int c = 0; c < channels; ++c) {
      double sum = 0;
      for (int j = 0; j < 4; ++j) {
        const float* row = source.row(support->v + j) + static_cast<std::ptrdiff_t>(support->u) * channels + c;
        sum += wv[j] * (wu[0] * row[0] + wu[1] * row[channels] + wu[2] * row[2 * channels] + wu[3] * row[3 * channels]);
      }
      result.image(u, v, c) = static_cast<float>(sum);
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
    for (int j = 0; support && j < 4; ++j) {
      const std::uint8_t* row = flags.row(support->v + j) + support->u;
      any |= row[0] | row[1] | row[2] | row[3];
    }
    result(u, v) = any != 0 ? 255 : 0;
  });
  return result;
}

}  // namespace malus
