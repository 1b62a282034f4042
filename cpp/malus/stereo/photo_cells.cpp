#include <algorithm>

#include "malus/core/parallel_internal.h"
#include "malus/stereo/photo_cells_internal.h"

namespace malus {
namespace {

constexpr float largest_code = 65535;

}  // namespace

PhotoCells::PhotoCells(const Image<float>& photo, const Context& context)
    : size_(photo.size()), pairs_(photo.size().area() + 1) {
  pairs_.back() = 0;
  if (photo.empty()) return;
  const auto [least, most] = std::minmax_element(photo.begin(), photo.end());
  least_ = *least;
  if (*most > least_) step_ = (*most - least_) / largest_code;
  const float scale = 1 / step_;
  parallel_rows(context, size_.height, [&](int v) {
    const auto width = static_cast<std::size_t>(size_.width);
    const float *const upper = photo.row(v), *const lower = photo.row(std::min(v + 1, size_.height - 1));
    const auto code = [&](float value) {
      // Via int, the conversion that vector units have.
      return static_cast<std::uint32_t>(static_cast<int>(std::min((value - least_) * scale + 0.5F, largest_code)));
    };
    std::uint32_t* const out = &pairs_[static_cast<std::size_t>(v) * width];
    for (std::size_t u = 0; u < width; ++u) out[u] = code(upper[u]) | code(lower[u]) << 16;
  });
}

Image<float> PhotoCells::intensity() const {
  Image<float> photo = Image<float>::uninitialized(size_);
  for (std::size_t i = 0; i < photo.count(); ++i) photo[i] = least_ + step_ * static_cast<float>(pairs_[i] & 0xFFFFU);
  return photo;
}

}  // namespace malus
