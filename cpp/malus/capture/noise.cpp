#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "malus/capture/noise_internal.h"

namespace malus {
namespace {

constexpr int block_px = 8, intensity_bins = 16;
constexpr std::size_t least_blocks = 100, least_blocks_in_bin = 30;
/// Lower decile of the mean square over one block's 64 correlated responses, in units of its expectation (simulated).
constexpr double decile_of_block = 0.67;

struct NoiseBlock {
  double signal, variance;
};

std::optional<NoiseBlock> block_at(const Image<float>& image, const Mask& saturated, int u0, int v0) {
  double signal = 0, energy = 0;
  for (int v = v0; v < v0 + block_px; ++v) {
    for (int u = u0; u < u0 + block_px; ++u) {
      if (saturated(u, v)) return std::nullopt;
      const double response = image(u - 1, v - 1) + image(u + 1, v - 1) + image(u - 1, v + 1) + image(u + 1, v + 1) -
                              2.0 * (image(u, v - 1) + image(u, v + 1) + image(u - 1, v) + image(u + 1, v)) +
                              4.0 * image(u, v);
      signal += image(u, v);
      energy += response * response / 36;
    }
  }
  return NoiseBlock{signal / (block_px * block_px), energy / (block_px * block_px)};
}

/// Lower deciles of equally filled bins of intensity.
std::vector<NoiseBlock> quietest_blocks(std::vector<NoiseBlock> blocks) {
  std::sort(blocks.begin(), blocks.end(), [](const NoiseBlock& a, const NoiseBlock& b) { return a.signal < b.signal; });
  const std::size_t size = std::max(least_blocks_in_bin, blocks.size() / intensity_bins);
  std::vector<NoiseBlock> quietest;
  for (std::size_t begin = 0; begin + size <= blocks.size(); begin += size) {
    const auto first = blocks.begin() + static_cast<std::ptrdiff_t>(begin),
               last = first + static_cast<std::ptrdiff_t>(size);
    double signal = 0;
    for (auto block = first; block != last; ++block) signal += block->signal / static_cast<double>(size);
    const auto decile = first + static_cast<std::ptrdiff_t>(size / 10);
    std::nth_element(first, decile, last,
                     [](const NoiseBlock& a, const NoiseBlock& b) { return a.variance < b.variance; });
    quietest.push_back({signal, decile->variance / decile_of_block});
  }
  return quietest;
}

/// A color mosaic's samples behind one polarizer and one green filter: every fourth pixel of every fourth row. All
/// neighbors in the mosaic itself include other colors, whose differences would pass for noise.
LinearImage samples_of_one_filter(const LinearImage& mosaic, BayerPattern colors) {
  constexpr int period = 4;
  const int place = static_cast<int>(enum_name(colors).find('G')), u0 = 2 * (place % 2), v0 = 2 * (place / 2);
  const Size size = mosaic.intensity.size();
  const Size alike{(size.width - u0 + period - 1) / period, (size.height - v0 + period - 1) / period};
  LinearImage samples{Image<float>(alike), Mask(alike)};
  for_each_pixel(alike, [&](int u, int v) {
    samples.intensity(u, v) = mosaic.intensity(u0 + period * u, v0 + period * v);
    samples.saturated(u, v) = mosaic.saturated(u0 + period * u, v0 + period * v);
  });
  return samples;
}

/// 1 / full well of the shot noise that stands for quantization behind a response curve, matched at half of white; 0
/// for a linear response. Frames are averaged before they are quantized.
double quantization_as_shot_noise(const ResponseCurve& curve, const Levels& levels, double frames) {
  if (curve.is_identity()) return 0;
  const double signal = 0.5;
  double low = 0, high = 1;
  for (int i = 0; i < 40; ++i) {
    const double middle = 0.5 * (low + high),
                 scale = curve.kind == ResponseCurve::Kind::table ? std::max(1.0, curve.encoded.back()) : 1.0;
    (curve.linearize(middle * scale) < signal ? low : high) = middle;
  }
  const double step = levels.dn_step * curve.slope(low);
  return frames * step * step / 12 / signal;
}

/// Another full well; the noise without light stays the same.
void set_full_well(NoiseModel& noise, double full_well_e) {
  noise.read_noise_e *= full_well_e / noise.full_well_e;
  noise.full_well_e = full_well_e;
}

}  // namespace

std::optional<NoiseModel> estimate_noise(const Image<float>& intensity, const Mask& saturated) {
  std::vector<NoiseBlock> blocks;
  for (int v = 1; v + block_px < intensity.height(); v += block_px) {
    for (int u = 1; u + block_px < intensity.width(); u += block_px) {
      if (const auto block = block_at(intensity, saturated, u, v)) blocks.push_back(*block);
    }
  }
  if (blocks.size() < least_blocks) return std::nullopt;

  // Straight line with relative weights; texture only adds variance, so bins above the line get less weight.
  const std::vector<NoiseBlock> bins = quietest_blocks(std::move(blocks));
  double offset = 0, slope = 0;
  for (int iteration = 0; iteration < 10; ++iteration) {
    double s = 0, sx = 0, sy = 0, sxx = 0, sxy = 0;
    for (const NoiseBlock& bin : bins) {
      const double expected = offset + slope * bin.signal;
      const double relative = expected > 0 ? bin.variance / expected : 1.0;
      const double weight =
          (relative > 1 ? 1 / (relative * relative) : 1.0) / std::max(bin.variance * bin.variance, 1e-24);
      s += weight;
      sx += weight * bin.signal;
      sy += weight * bin.variance;
      sxx += weight * bin.signal * bin.signal;
      sxy += weight * bin.signal * bin.variance;
    }
    const double determinant = s * sxx - sx * sx;
    slope = determinant > 1e-9 * s * sxx ? std::max((s * sxy - sx * sy) / determinant, 0.0) : 0.0;
    offset = (sy - slope * sx) / s;
    if (offset < 0) {
      offset = 0;
      slope = sxx > 0 ? std::max(sxy / sxx, 0.0) : 0.0;
    }
  }
  NoiseModel noise;
  noise.full_well_e = 1 / std::clamp(slope, 1e-7, 1e-2);
  noise.read_noise_e = std::sqrt(offset) * noise.full_well_e;
  return noise;
}

NoiseModel noise_model(const PolarizedSpec& spec, const ResponseCurve& curve, const Levels& levels,
                       const std::optional<std::array<double, 3>>& color_weights, const LinearImage& base) {
  NoiseModel noise;
  noise.frames_averaged = spec.frames_averaged;
  double squares = color_weights ? 0 : 1;
  if (color_weights) {
    for (const double weight : *color_weights) squares += weight * weight;
  }
  const double frames = spec.frames_averaged, quantized = squares * quantization_as_shot_noise(curve, levels, frames);
  noise.quantization = std::sqrt(squares) * levels.dn_step * curve.slope(0);
  if (!spec.full_well_e) {
    // The estimate already includes the sum of channels, and quantization where noise is as large as a step. Less noise
    // leaves no trace of quantization, as in smooth parts of a JPEG.
    const std::optional<LinearImage> alike =
        spec.mosaic_colors ? std::optional(samples_of_one_filter(base, *spec.mosaic_colors)) : std::nullopt;
    const LinearImage& samples = alike ? *alike : base;
    if (const auto estimate = estimate_noise(samples.intensity, samples.saturated)) {
      noise.full_well_e = estimate->full_well_e / frames;
      noise.read_noise_e =
          spec.read_noise_e ? *spec.read_noise_e / std::sqrt(squares) : estimate->read_noise_e / std::sqrt(frames);
      if (quantized * noise.full_well_e > 1) set_full_well(noise, 1 / quantized);
      return noise;
    }
  }
  noise.full_well_e = spec.full_well_e.value_or(noise.full_well_e) / squares;
  noise.read_noise_e = spec.read_noise_e.value_or(noise.read_noise_e) / std::sqrt(squares);
  if (!curve.is_identity()) set_full_well(noise, 1 / (1 / noise.full_well_e + quantized));
  return noise;
}

}  // namespace malus
