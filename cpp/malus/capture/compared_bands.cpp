#include <algorithm>
#include <cmath>

#include "malus/capture/compared_bands_internal.h"
#include "malus/capture/registration_rows_internal.h"
#include "malus/core/parallel_internal.h"

namespace malus {
namespace {

constexpr int tiles_across = 12, tiles_down = 8;
/// Largest number of pixels compared on one level.
constexpr std::size_t most_pixels = std::size_t{2} << 20;
/// Distance from the image's border [px] for interpolation and gradients.
constexpr int interpolation_margin = 4;

/// Blocks of each tile; the uncertainty is estimated from the scatter between tiles. A small image uses all blocks. A
/// large one uses those with most texture in each tile, up to `most_pixels`: more blocks would only improve an estimate
/// that is already far more precise than needed.
std::vector<std::vector<RegistrationBlock>> choose_blocks(const ContrastBands& contrast, const Context& context) {
  const Size size = contrast.information.size();
  const Image<float>& band = contrast.bands[0];
  std::vector<std::vector<RegistrationBlock>> tiles(tiles_across * tiles_down);
  for (int v = 0; v < size.height; v += block_rows) {
    for (int u = 0; u < size.width; u += BlockRow::columns) {
      const PixelRect pixels{u, v, std::min(u + BlockRow::columns, size.width), std::min(v + block_rows, size.height)};
      const long column = static_cast<long>(pixels.u0 + pixels.u1) * tiles_across / (2 * size.width);
      const long row = static_cast<long>(pixels.v0 + pixels.v1) * tiles_down / (2 * size.height);
      tiles[static_cast<std::size_t>(row * tiles_across + column)].push_back({pixels});
    }
  }
  const double share = static_cast<double>(most_pixels) / static_cast<double>(size.area());
  if (share >= 1) return tiles;
  parallel_for(context, tiles.size(), 1, [&](std::size_t t, std::size_t) {
    std::vector<RegistrationBlock>& blocks = tiles[t];
    for (RegistrationBlock& block : blocks) {
      for (int v = block.pixels.v0 + 1; v < block.pixels.v1 - 1; v += 4) {
        for (int u = block.pixels.u0 + 1; u < block.pixels.u1 - 1; ++u) {
          const float gu = band(u + 1, v) - band(u - 1, v), gv = band(u, v + 1) - band(u, v - 1);
          block.energy += static_cast<double>(contrast.information(u, v) * (gu * gu + gv * gv));
        }
      }
    }
    std::stable_sort(blocks.begin(), blocks.end(),
                     [](const RegistrationBlock& a, const RegistrationBlock& b) { return a.energy > b.energy; });
    blocks.resize(static_cast<std::size_t>(std::ceil(share * static_cast<double>(blocks.size()))));
  });
  return tiles;
}

}  // namespace

ComparedBands compared_bands(const std::vector<Image<float>>& images, const std::vector<Image<float>>& quarters,
                             const NoiseModel& noise, const RegistrationOptions& options, const Context& context) {
  const Size size = images[0].size();
  ComparedBands compared;
  compared.contrast =
      contrast_bands(images, quarters, {options.fine_sigma_px, options.coarse_sigma_px}, noise, context);
  compared.blocks = choose_blocks(compared.contrast, context);
  const int band_margin = static_cast<int>(std::lround(1.5 * options.coarse_sigma_px));
  compared.margin = std::max(std::min(band_margin, std::min(size.width, size.height) / 8), interpolation_margin);
  return compared;
}

}  // namespace malus
