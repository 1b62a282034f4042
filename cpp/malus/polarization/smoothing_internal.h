#pragma once

#include "malus/core/context.h"
#include "malus/polarization/polarization_state.h"

namespace malus {

/// Residuals are clipped here: larger ones are from moved things or highlights and are not typical of their neighbors.
inline constexpr float largest_typical_residual = 30;

/// Smooths polarization where it changes from pixel to pixel because of texture, for images that were moved by
/// fractions of a pixel: interpolation changes fine texture differently in each of them, so that it passes for
/// polarization.
///
/// A local Wiener filter (Lee 1980) of (s1, s2) / s0. The variance of the errors is the noise model's times the squared
/// residuals of the sinusoid, which texture raises as it raises the errors; what exceeds the noise model's is texture.
/// Polarization moves towards its mean over the neighbors (Gaussian, 0.8 px) by the share of texture in the mean square
/// of the difference from this mean, without noise (all over a Gaussian, 3 px). Where there is no such texture, and
/// where nothing is left over from the fit, as with three images, nothing changes: fusion weighs noise itself.
///
/// Intensities, residuals and the noise model stay. Neighbors share errors afterwards, and together know as much as
/// before. Large images are smoothed in strips of rows, which need little memory and change no bit.
void smooth_polarization(PolarizationState& state, const Context& context);

}  // namespace malus
