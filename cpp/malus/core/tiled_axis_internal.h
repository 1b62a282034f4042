#pragma once

#include <algorithm>
#include <cstdint>

#include "malus/core/pixel_rect_internal.h"

namespace malus {

/// One axis of a raster cut into tiles that overlap. Across a cut the weight of one tile falls as that of the next
/// rises; the weights of all tiles add up to 1 at every pixel.
class TiledAxis {
 public:
  /// Cuts the pixels begin … end − 1 into `tiles` tiles of nearly the same size, each extended by `margin` beyond its
  /// cuts. Weights change within `ramp` of a cut; `ramp` is at most the margin.
  TiledAxis(int begin, int end, int tiles, int margin, int ramp)
      : begin_(begin), end_(end), tiles_(tiles), margin_(margin), ramp_(ramp) {}

  int tiles() const { return tiles_; }
  int first(int tile) const { return tile == 0 ? begin_ : std::max(begin_, cut(tile) - margin_); }
  int last(int tile) const { return tile == tiles_ - 1 ? end_ : std::min(end_, cut(tile + 1) + margin_); }
  double weight(int tile, int x) const { return rise(tile, x) * (1 - rise(tile + 1, x)); }

 private:
  int cut(int tile) const {
    return begin_ + static_cast<int>(static_cast<std::int64_t>(end_ - begin_) * tile / tiles_);
  }
  /// Rises from 0 to 1 across the start of a tile.
  double rise(int tile, int x) const {
    if (tile == 0) return 1;
    if (tile == tiles_) return 0;
    return std::clamp((x + 0.5 - cut(tile) + ramp_) / (2.0 * ramp_), 0.0, 1.0);
  }

  int begin_, end_, tiles_, margin_, ramp_;
};

/// An image cut into overlapping tiles, numbered row by row. Pixels near a tile's cuts have weight 0, so that they may
/// be held there.
class TiledImage {
 public:
  TiledImage(Size image, int tile_px, int margin)
      : columns_(axis(image.width, tile_px, margin)), rows_(axis(image.height, tile_px, margin)) {}
  /// A part of an image; weights change within the whole margin.
  TiledImage(const PixelRect& part, int columns, int rows, int margin)
      : columns_(part.u0, part.u1, columns, margin, margin), rows_(part.v0, part.v1, rows, margin, margin) {}

  int tiles() const { return columns_.tiles() * rows_.tiles(); }
  PixelRect box(int tile) const {
    const int column = tile % columns_.tiles(), row = tile / columns_.tiles();
    return {columns_.first(column), rows_.first(row), columns_.last(column), rows_.last(row)};
  }
  double weight(int tile, int u, int v) const {
    return columns_.weight(tile % columns_.tiles(), u) * rows_.weight(tile / columns_.tiles(), v);
  }

 private:
  static TiledAxis axis(int extent, int tile_px, int margin) {
    return {0, extent, std::max(1, (extent + tile_px / 2) / tile_px), margin, margin / 2};
  }

  TiledAxis columns_, rows_;
};

}  // namespace malus
