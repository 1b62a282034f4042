#pragma once

#include <functional>

#include "malus/core/context.h"
#include "malus/core/image.h"

namespace malus {

/// Writes the columns [begin, end) of a raster's row to `values`; called from several threads.
using RowSource = std::function<void(int row, int begin, int end, float* values)>;

/// A one-channel raster without its low frequencies: value minus the Gaussian mean (standard deviation sigma_px, cut at
/// 4 sigma, mirrored at the border) of the finite values around it. NaN stays NaN and has no part in any mean.
Image<float> high_pass(const Image<float>& values, double sigma_px, const Context& context);
/// The same of a raster that is made when it is asked for.
Image<float> high_pass(Size size, const RowSource& values, double sigma_px, const Context& context);

}  // namespace malus
