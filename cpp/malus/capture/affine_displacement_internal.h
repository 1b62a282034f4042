#pragma once

#include <Eigen/Core>
#include <vector>

#include "malus/capture/resampling_internal.h"
#include "malus/core/pixel_rect_internal.h"

namespace malus {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

/// Displacement p(x) = (p0 + p2 x + p3 y, p1 + p4 x + p5 y), x and y from the center in units of the width.
Affine displaced(const Affine& map, const Vector6& p, Size size);

/// Mean square of the displacement over corners and center, for a covariance (or outer product) of the parameters.
double mean_square_displacement(const Matrix6& covariance, Size size);

/// RMS displacement of an affine map from another over corners and center of an image [px].
double affine_distance_px(const Affine& a, const Affine& b, Size size);

/// Pixels that stay `margin` pixels off the border in every image, wherever the maps move them.
PixelRect common_region(const std::vector<Affine>& maps, Size size, int margin);

}  // namespace malus
