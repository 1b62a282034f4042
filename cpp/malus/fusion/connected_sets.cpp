#include <utility>

#include "malus/fusion/connected_sets_internal.h"

namespace malus {

std::vector<PixelSet> connected_sets(const Mask& mask) {
  const auto width = static_cast<std::size_t>(mask.width());
  std::vector<PixelSet> sets;
  Mask seen(mask.size());
  for (std::size_t start = 0; start < mask.count(); ++start) {
    if (!mask[start] || seen[start]) continue;
    PixelSet pixels{start};
    seen[start] = 255;
    const auto visit = [&](std::size_t next) {
      if (!mask[next] || seen[next]) return;
      seen[next] = 255;
      pixels.push_back(next);
    };
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      const std::size_t pixel = pixels[i], u = pixel % width;
      if (u > 0) visit(pixel - 1);
      if (u + 1 < width) visit(pixel + 1);
      if (pixel >= width) visit(pixel - width);
      if (pixel + width < mask.count()) visit(pixel + width);
    }
    sets.push_back(std::move(pixels));
  }
  return sets;
}

}  // namespace malus
