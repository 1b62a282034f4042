#include <algorithm>

#include "malus/linalg/nested_dissection_internal.h"

namespace malus {
namespace {

/// Boxes of at most this many pixels are numbered without further division.
constexpr int leaf_pixels = 64;

class Dissection {
 public:
  Dissection(const PixelIndex& pixels, int reach) : pixels_(pixels), reach_(reach) {
    order_.reserve(static_cast<std::size_t>(pixels.count()));
  }

  /// Orders the unknowns of columns [u0, u1), rows [v0, v1).
  void dissect(int u0, int v0, int u1, int v1) {
    const int width = u1 - u0, height = v1 - v0;
    if (width <= 0 || height <= 0) return;
    if (width * height <= leaf_pixels || std::max(width, height) <= 2 * reach_) {
      number(u0, v0, u1, v1);
    } else if (width >= height) {
      const int cut = u0 + (width - reach_) / 2;
      dissect(u0, v0, cut, v1);
      dissect(cut + reach_, v0, u1, v1);
      number(cut, v0, cut + reach_, v1);
    } else {
      const int cut = v0 + (height - reach_) / 2;
      dissect(u0, v0, u1, cut);
      dissect(u0, cut + reach_, u1, v1);
      number(u0, cut, u1, cut + reach_);
    }
  }

  std::vector<int> take() { return std::move(order_); }

 private:
  /// Numbers the unknowns line by line along the shorter side, so that a separator's fill stays in a band.
  void number(int u0, int v0, int u1, int v1) {
    const bool tall = v1 - v0 > u1 - u0;
    const int outer = tall ? v1 - v0 : u1 - u0, inner = tall ? u1 - u0 : v1 - v0;
    for (int a = 0; a < outer; ++a) {
      for (int b = 0; b < inner; ++b) {
        const int unknown = tall ? pixels_.at(u0 + b, v0 + a) : pixels_.at(u0 + a, v0 + b);
        if (unknown >= 0) order_.push_back(unknown);
      }
    }
  }

  const PixelIndex& pixels_;
  int reach_;
  std::vector<int> order_;
};

}  // namespace

std::vector<int> nested_dissection(const PixelIndex& pixels, int reach) {
  Dissection dissection(pixels, reach);
  dissection.dissect(0, 0, pixels.size().width, pixels.size().height);
  return dissection.take();
}

}  // namespace malus
