#pragma once

#include <span>
#include <vector>

#include "malus/capture/resampling_internal.h"

namespace malus {

/// Row by row arithmetic of registration, in single precision; most of registration's time is spent here.
struct BlockRow {
  static constexpr int columns = 62;          ///< of a block
  static constexpr int length = columns + 2;  ///< with one more on either side for gradients
};

/// Values of `band` at the positions of the first image's pixels (u, v), (u + 1, v), … by cubic convolution with
/// a = −0.5 (Keys 1981), which does not displace ramps: the images' true places are wanted. The bands are too smooth to
/// need splines, which would have to be made of them first. The 4 × 4 samples of each position must exist. Near the
/// identity, neighboring pixels have neighboring samples, which are loaded together.
void resample_row(const Image<float>& band, const Affine& map, int u, int v, std::span<float> values);

/// A row of every aligned image, and this row and its two neighbors in the images' mean. Each pointer is to
/// BlockRow::length values.
struct AlignedRow {
  std::span<const float* const> bands;  ///< one per image
  const float *mean, *mean_above, *mean_below;
  const float* information;  ///< 1 / noise variance; 0 for pixels without weight, such as the first and last
  float x;                   ///< of the first pixel, from the image's center in units of its width …
  float x_step;              ///< … and from pixel to pixel
};

/// Sums over the pixels of a row, weighted by their information and the agreement of the images; g = gradient of the
/// mean.
struct RowSums {
  double gradients[3][3] = {};  ///< g_u², g_u g_v, g_v²; times 1, x, x²
  struct Side {
    double along_u[2] = {}, along_v[2] = {};  ///< residual of the image times g; times 1, x
  };
  std::vector<Side> sides;  ///< one per image
};

/// Disagreement of the images at each pixel, per degree of freedom, in units of the noise variance; length values.
void disagreements(const AlignedRow& row, float* values);
/// The sums of a row, and each pixel's weight. cauchy: disagreement that halves a weight.
void sum_row(const AlignedRow& row, float cauchy, RowSums& sums, float* weights);
/// Mean of the images; length values.
void mean_row(std::span<const float* const> bands, float* mean);

}  // namespace malus
