#pragma once

#include <array>
#include <optional>
#include <string>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/io/station_spec.h"

namespace malus {

/// A mosaic's four images, in the order top left, top right, bottom left, bottom right of the cell.
struct MosaicSplit {
  std::array<Image<float>, 4> channels;
  /// Number of neighboring pixels that share one measurement of polarization, so that their errors are correlated.
  Image<float> shared;
};

/// Splits a mosaic with a 2 × 2 cell of polarizers into four full-size images; all four show the same point at the same
/// pixel, and measured samples are passed through unchanged.
///
/// Polarization varies less than brightness: with d_p = I_p / L − 1, L the mean over the polarizers, every sample gives
/// L = I_p / (1 + d_p) at its own pixel, so that texture keeps the mosaic's full resolution. d_p is interpolated
/// bilinearly between its samples and smoothed. L and d_p are computed in rounds that start with L = the mean of the
/// bilinearly interpolated channels: two rounds with smoothing by 0.7 px where polarization is strong, eight rounds
/// with 2 px where texture is far stronger than polarization.
///
/// `mosaic` is linear, 1 channel, with even width and height of at least 8; anything else is an input error naming
/// `name`.
MosaicSplit demosaic(const Image<float>& mosaic, const std::string& name, const Context& context);

/// Splits the mosaic of a color polarization camera into one mosaic per color (R, G, B), each an input of `demosaic`.
/// Each 2 × 2 cell of polarizers lies under one color filter, and 2 × 2 cells make the Bayer pattern `colors`. Each
/// color is interpolated bilinearly among the samples of one polarizer. Use this only for the polarization of a single
/// color, because bilinear interpolation turns texture into false polarization. Width and height are multiples of 4.
std::array<Image<float>, 3> split_colors(const Image<float>& mosaic, BayerPattern colors, const std::string& name,
                                         const Context& context);

/// A color polarization camera's mosaic: intensities behind the polarizers in the order of the cell, free of color, and
/// each color's brightness relative to them (R, G, B).
struct ColorMosaic {
  MosaicSplit gray;
  std::array<Image<float>, 3> ratios;
};

/// Splits a mosaic as split_colors describes it under the assumption that all colors are polarized alike. Color varies
/// less than brightness, as polarization does. Each color's factor over its samples, smoothed (Gaussian, 2 px), is
/// divided out, and `demosaic` splits the resulting gray mosaic at full resolution; three rounds.
ColorMosaic demosaic_color(const Image<float>& mosaic, BayerPattern colors, const std::string& name,
                           const Context& context);

/// Question whether the Bayer pattern, or its lack, is right; empty if there is no doubt. Under a pattern of color
/// filters the mean brightness of the 2 × 2 cells repeats every second cell, equal in two opposite corners: the green
/// ones.
std::string doubt_of_colors(const Image<float>& mosaic, std::optional<BayerPattern> stated, const std::string& name);

/// 255 where a saturated sample lies within `reach` pixels, so that a demosaicked pixel may depend on it.
Mask spread_flags(const Mask& flags, int reach);

}  // namespace malus
