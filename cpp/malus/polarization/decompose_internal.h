#pragma once

#include <cstdint>
#include <span>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/options/polarization_options.h"
#include "malus/polarization/noise_model.h"
#include "malus/polarization/polarization_state.h"

namespace malus {

/// Condition number (2-norm) of the normal equations of the sinusoid fit at these polarizer angles: 2 for evenly spread
/// angles, infinite for fewer than three distinct angles modulo π.
double angle_condition(std::span<const double> angles_rad);

/// Fits I(a) = (s0 + s1 cos 2a + s2 sin 2a) / 2 to the K images of a stack, pixel by pixel, by linear least squares.
///
/// images: K of the same size, 1 channel, linear, in [0, 1] of the white level; angles_rad: one per image,
/// counterclockwise from image +x as displayed. The same angle several times (modulo π) counts as several exposures of
/// it. mask: non-zero = object; empty = everything. saturated: non-zero = clipped in some image; may be empty. A pixel
/// that is not finite in some image is outside. Saturated, dark and misfitting pixels keep their fitted values; `valid`
/// gives their state.
///
/// One pass over the stack in single precision; pixels that need more (noise weights, outliers) are fitted in double.
/// Beyond the stack it needs the memory of the result only. Throws an input error for sizes and counts that do not
/// match, a data error for fewer than three distinct angles modulo π or angles whose condition number exceeds
/// options.max_condition.
PolarizationState decompose(std::span<const Image<float>> images, std::span<const double> angles_rad,
                            const NoiseModel& noise, const Mask& mask, const Mask& saturated,
                            const DecomposeOptions& options, const Context& context);

/// The same for images that the caller owns (numpy): each `size` pixels, row major, without padding. 16-bit images are
/// read without conversion, white at 65535.
PolarizationState decompose(Size size, std::span<const float* const> images, std::span<const double> angles_rad,
                            const NoiseModel& noise, const Mask& mask, const Mask& saturated,
                            const DecomposeOptions& options, const Context& context);

PolarizationState decompose(Size size, std::span<const std::uint16_t* const> images, std::span<const double> angles_rad,
                            const NoiseModel& noise, const Mask& mask, const Mask& saturated,
                            const DecomposeOptions& options, const Context& context);

}  // namespace malus
