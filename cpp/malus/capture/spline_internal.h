#pragma once

#include <array>

#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// Interpolation by cubic B-splines (Unser, Aldroubi, Eden 1993): a recursive filter turns samples into coefficients,
/// and a value between samples is a weighted sum of 4 × 4 coefficients.
constexpr int spline_support = 4;

/// Weights of the coefficients at floor(x) − 1 … floor(x) + 2 for the fraction x − floor(x).
std::array<float, spline_support> spline_weights(double fraction);

/// Replaces the samples of an image with any number of channels by the coefficients of the spline through them. Beyond
/// the border the image continues point-symmetrically about its outermost samples, so that ramps stay ramps. Samples
/// must be finite: the filter runs along whole rows and columns. Results do not depend on threads.
void to_spline_coefficients(Image<float>& image, const Context& context);

}  // namespace malus
