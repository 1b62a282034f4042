#pragma once

#include <algorithm>

#include "malus/core/image.h"

namespace malus {

/// Part of a raster: columns [u0, u1), rows [v0, v1).
struct PixelRect {
  int u0 = 0, v0 = 0, u1 = 0, v1 = 0;

  int width() const { return u1 - u0; }
  int height() const { return v1 - v0; }
  Size size() const { return {width(), height()}; }
  bool empty() const { return u1 <= u0 || v1 <= v0; }
  bool contains(int u, int v) const { return u >= u0 && v >= v0 && u < u1 && v < v1; }
  bool operator==(const PixelRect&) const = default;
  PixelRect intersected(const PixelRect& other) const {
    return {std::max(u0, other.u0), std::max(v0, other.v0), std::min(u1, other.u1), std::min(v1, other.v1)};
  }
  /// This rectangle grown by `by` pixels on each side, clipped to an image of size `image`.
  PixelRect grown(int by, Size image) const {
    return {std::max(u0 - by, 0), std::max(v0 - by, 0), std::min(u1 + by, image.width),
            std::min(v1 + by, image.height)};
  }
  /// Whether pixel (u, v) of this part of an image is among the `width` pixels along an edge beyond which the image
  /// continues.
  bool is_at_cut(int u, int v, int width, Size image) const {
    return (u0 > 0 && u < u0 + width) || (v0 > 0 && v < v0 + width) || (u1 < image.width && u >= u1 - width) ||
           (v1 < image.height && v >= v1 - width);
  }
  /// The same pixels in the coordinates of an image whose top-left pixel is (u, v) here.
  PixelRect from(int u, int v) const { return {u0 - u, v0 - v, u1 - u, v1 - v}; }
};

/// The square of 2 reach + 1 pixels a side about a pixel, clipped to the image.
inline PixelRect square_about(int u, int v, int reach, Size image) {
  return PixelRect{u, v, u + 1, v + 1}.grown(reach, image);
}

/// Calls body(u, v) row by row for the pixels of a part, or for those of them that are set in a mask of the image.
template <class Body>
void for_each_pixel(const PixelRect& part, Body&& body) {
  for (int v = part.v0; v < part.v1; ++v) {
    for (int u = part.u0; u < part.u1; ++u) body(u, v);
  }
}
template <class Body>
void for_each_pixel(const PixelRect& part, const Mask& mask, Body&& body) {
  for_each_pixel(part, [&](int u, int v) {
    if (mask(u, v) != 0) body(u, v);
  });
}

/// The smallest rectangle with all pixels of a part of a mask that are set; v0 ≥ v1 if none is.
inline PixelRect bounding_box(const Mask& mask, const PixelRect& part) {
  PixelRect box{part.u1, part.v1, part.u0, part.v0};
  for_each_pixel(part, mask, [&](int u, int v) {
    box = {std::min(box.u0, u), std::min(box.v0, v), std::max(box.u1, u + 1), std::max(box.v1, v + 1)};
  });
  return box;
}

/// The same for the whole mask; u1 = v1 = 0 if no pixel is set.
inline PixelRect bounding_box(const Mask& mask) {
  return bounding_box(mask, {0, 0, mask.width(), mask.height()});
}

/// The pixels of a square cell, in an image that cells cover from its first pixel on.
inline PixelRect cell_rect(int column, int row, int cell_px, Size image) {
  const PixelRect cell{column * cell_px, row * cell_px, (column + 1) * cell_px, (row + 1) * cell_px};
  return cell.intersected({0, 0, image.width, image.height});
}

/// Copy of a part of a raster; an empty raster gives an empty copy.
template <class T>
Image<T> cropped(const Image<T>& whole, const PixelRect& rect) {
  if (whole.empty()) return {};
  Image<T> part = Image<T>::uninitialized(rect.size(), whole.channels());
  for (int v = rect.v0; v < rect.v1; ++v) {
    const T* const row = whole.row(v);
    std::copy(row + rect.u0 * whole.channels(), row + rect.u1 * whole.channels(), part.row(v - rect.v0));
  }
  return part;
}

/// Copies a part into a raster, to the place that it was cropped from.
template <class T>
void paste(const Image<T>& part, const PixelRect& rect, Image<T>& whole) {
  for (int v = rect.v0; v < rect.v1; ++v) {
    const T* const row = part.row(v - rect.v0);
    std::copy(row, row + rect.width() * whole.channels(), whole.row(v) + rect.u0 * whole.channels());
  }
}

}  // namespace malus
