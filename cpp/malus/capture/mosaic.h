#pragma once

#include <array>
#include <string>

#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// Splits a mosaic with a 2 × 2 cell of polarizers into four full-size images, in the order top left, top right,
/// bottom left, bottom right of the cell; all four show the same point at the same pixel, and what is measured is
/// passed through unchanged.
///
/// Polarization varies less than brightness: with d_p = I_p / L − 1, L the mean over the polarizers, every sample gives
/// L = I_p / (1 + d_p) at its own pixel, so that texture keeps the mosaic's full resolution. d_p is interpolated
/// bilinearly between its samples and smoothed (Gaussian, 0.7 px); two rounds from the mean of the bilinear channels.
///
/// `mosaic` is linear, 1 channel, with even width and height of at least 8; anything else is an input error naming
/// `name`.
std::array<Image<float>, 4> demosaic(const Image<float>& mosaic, const std::string& name, const Context& context);

/// Splits the mosaic of a colour polarization camera into one mosaic a colour (R, G, B), to be handed to `demosaic`.
/// Each 2 × 2 cell of polarizers lies under one colour filter, and 2 × 2 cells make a Bayer pattern: `colors` are its
/// letters by rows, such as "RGGB". Among the samples of one polarizer each colour is interpolated bilinearly.
/// Width and height are multiples of 4.
std::array<Image<float>, 3> split_colors(const Image<float>& mosaic, const std::string& colors, const std::string& name,
                                         const Context& context);

/// 255 where a saturated sample is among the `reach` pixels around: those that make a demosaicked pixel.
Mask spread_flags(const Mask& flags, int reach, const Context& context);

}  // namespace malus
