#pragma once

#include <cstddef>
#include <cstdint>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/core/large_allocator.h"

namespace malus {

/// A photo for bilinear interpolation: intensities in 16 bits, in steps of 1/65535 of the photo's range. Each is stored
/// with the pixel below, so that the four pixels around a point are 8 consecutive bytes. Takes as much memory as
/// floats.
class PhotoCells {
 public:
  PhotoCells(const Image<float>& photo, const Context& context);

  Size size() const { return size_; }
  /// The photo's intensities, exact to half a step.
  Image<float> intensity() const;
  /// Pixel (u, v) in the low 16 bits, (u, v + 1) in the high ones, at v · width + u. One extra value follows the last
  /// pixel.
  const std::uint32_t* pairs() const { return pairs_.data(); }
  /// Intensity = least + step · 16-bit value.
  float least() const { return least_; }
  float step() const { return step_; }

 private:
  Size size_;
  float least_ = 0, step_ = 1;
  LargeVector<std::uint32_t> pairs_;
};

}  // namespace malus
