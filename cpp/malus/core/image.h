#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "malus/core/error.h"
#include "malus/core/large_allocator.h"

namespace malus {

/// Marks pixels without a value in rasters of real numbers.
inline constexpr float no_value = std::numeric_limits<float>::quiet_NaN();

/// Size of a raster in pixels.
struct Size {
  int width = 0;
  int height = 0;

  std::size_t area() const { return static_cast<std::size_t>(width) * static_cast<std::size_t>(height); }
  /// Index of the pixel at column u, row v, counted row by row.
  std::size_t index(int u, int v) const {
    return static_cast<std::size_t>(v) * static_cast<std::size_t>(width) + static_cast<std::size_t>(u);
  }
  bool operator==(const Size&) const = default;
};

inline std::string to_string(Size size) {
  return std::to_string(size.width) + " x " + std::to_string(size.height);
}

/// A raster that owns its pixels: height × width × channels, row major, channels interleaved, no padding.
/// Pixel coordinates are (u, v) = (column, row) with the center of the top-left pixel at (0, 0).
template <class T>
class Image {
 public:
  using value_type = T;

  Image() = default;
  Image(Size size, int channels = 1, T value = T{})
      : size_(size), channels_(channels), pixels_(size.area() * static_cast<std::size_t>(channels), value) {}
  /// An image with undefined values, all of which must be written. The memory is not touched here, so the threads that
  /// write the image share the cost of first access to it.
  static Image uninitialized(Size size, int channels = 1) {
    Image image;
    image.size_ = size;
    image.channels_ = channels;
    image.pixels_ = Pixels(size.area() * static_cast<std::size_t>(channels));
    return image;
  }

  int width() const { return size_.width; }
  int height() const { return size_.height; }
  int channels() const { return channels_; }
  Size size() const { return size_; }
  bool empty() const { return pixels_.empty(); }
  /// Number of values, width · height · channels.
  std::size_t count() const { return pixels_.size(); }

  T* data() { return pixels_.data(); }
  const T* data() const { return pixels_.data(); }
  T* row(int v) { return pixels_.data() + offset(0, v, 0); }
  const T* row(int v) const { return pixels_.data() + offset(0, v, 0); }

  /// Value at column u, row v, channel c. Not checked.
  T& operator()(int u, int v, int c = 0) { return pixels_[offset(u, v, c)]; }
  const T& operator()(int u, int v, int c = 0) const { return pixels_[offset(u, v, c)]; }
  /// Value by its index in memory (pixel index for one-channel rasters). Not checked.
  T& operator[](std::size_t index) { return pixels_[index]; }
  const T& operator[](std::size_t index) const { return pixels_[index]; }

  bool contains(int u, int v) const { return u >= 0 && v >= 0 && u < size_.width && v < size_.height; }

  auto begin() { return pixels_.begin(); }
  auto end() { return pixels_.end(); }
  auto begin() const { return pixels_.begin(); }
  auto end() const { return pixels_.end(); }

  void fill(T value) { std::fill(pixels_.begin(), pixels_.end(), value); }
  bool operator==(const Image&) const = default;

 private:
  using Pixels = LargeVector<T>;

  std::size_t offset(int u, int v, int c) const {
    return size_.index(u, v) * static_cast<std::size_t>(channels_) + static_cast<std::size_t>(c);
  }

  Size size_;
  int channels_ = 0;
  Pixels pixels_;
};

/// Binary raster: non-zero = set (object, valid, …). One channel.
using Mask = Image<std::uint8_t>;

/// Calls body(u, v) row by row for the pixels of a raster, or for those that are set in a mask.
template <class Body>
void for_each_pixel(Size size, Body&& body) {
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) body(u, v);
  }
}
template <class Body>
void for_each_pixel(const Mask& mask, Body&& body) {
  for_each_pixel(mask.size(), [&](int u, int v) {
    if (mask(u, v) != 0) body(u, v);
  });
}

/// Throws an input error that names the raster unless it has this size.
template <class T>
void require_size(const Image<T>& image, Size expected, const std::string& name) {
  if (image.size() != expected) {
    throw input_error(name + " is " + to_string(image.size()) + " pixels, expected " + to_string(expected));
  }
}

}  // namespace malus
