#include <algorithm>
#include <cmath>

#include "malus/capture/registration_rows_internal.h"
#include "malus/core/simd_internal.h"

namespace malus {
namespace {

constexpr int length = BlockRow::length;

/// The weights of the samples at floor(x) − 1 … floor(x) + 2 for the fraction f = x − floor(x).
[[gnu::always_inline]] inline void cubic_weights(float f, float (&weights)[4]) {
  const float f2 = f * f, f3 = f2 * f;
  weights[0] = f2 - 0.5F * (f3 + f);
  weights[1] = 1.5F * f3 - 2.5F * f2 + 1;
  weights[2] = 2 * f2 - 1.5F * f3 + 0.5F * f;
  weights[3] = 0.5F * (f3 - f2);
}

/// Positions within their samples along a run of pixels; they change linearly, and the samples are neighbors.
struct Run {
  float fu, fu_step, fv, fv_step;
};

MALUS_SIMD_CLONES void resample_run(const float* corner, std::size_t stride, const Run& run, int count,
                                    float* __restrict values) {
  const float *r0 = corner, *r1 = r0 + stride, *r2 = r1 + stride, *r3 = r2 + stride;
  for (int i = 0; i < count; ++i) {
    float wu[4], wv[4];
    cubic_weights(run.fu + static_cast<float>(i) * run.fu_step, wu);
    cubic_weights(run.fv + static_cast<float>(i) * run.fv_step, wv);
    values[i] = wv[0] * (wu[0] * r0[i] + wu[1] * r0[i + 1] + wu[2] * r0[i + 2] + wu[3] * r0[i + 3]) +
                wv[1] * (wu[0] * r1[i] + wu[1] * r1[i + 1] + wu[2] * r1[i + 2] + wu[3] * r1[i + 3]) +
                wv[2] * (wu[0] * r2[i] + wu[1] * r2[i + 1] + wu[2] * r2[i + 2] + wu[3] * r2[i + 3]) +
                wv[3] * (wu[0] * r3[i] + wu[1] * r3[i + 1] + wu[2] * r3[i + 2] + wu[3] * r3[i + 3]);
  }
}

/// For how many pixels a position stays in its sample, if it starts at `fraction` and changes by `step` per pixel.
int pixels_within(double fraction, double step, int most) {
  const double pixels = step > 0   ? std::ceil((1 - fraction) / step)
                        : step < 0 ? std::floor(fraction / -step) + 1
                                   : static_cast<double>(most);
  return static_cast<int>(std::clamp(pixels, 1.0, static_cast<double>(most)));
}

}  // namespace

void resample_row(const Image<float>& band, const Affine& map, int u, int v, std::span<float> values) {
  const int count = static_cast<int>(values.size());
  for (int begin = 0; begin < count;) {
    const Eigen::Vector2d position = map.leftCols<2>() * Eigen::Vector2d(u + begin, v) + map.col(2);
    const double iu = std::floor(position.x()), iv = std::floor(position.y());
    const double fu = position.x() - iu, fv = position.y() - iv, fu_step = map(0, 0) - 1, fv_step = map(1, 0);
    const int run = std::min(pixels_within(fu, fu_step, count - begin), pixels_within(fv, fv_step, count - begin));
    resample_run(
        band.row(static_cast<int>(iv) - 1) + static_cast<std::ptrdiff_t>(iu) - 1,
        static_cast<std::size_t>(band.width()),
        {static_cast<float>(fu), static_cast<float>(fu_step), static_cast<float>(fv), static_cast<float>(fv_step)}, run,
        values.data() + begin);
    begin += run;
  }
}

MALUS_SIMD_CLONES void mean_row(std::span<const float* const> bands, float* __restrict mean) {
  const float share = 1.0F / static_cast<float>(bands.size());
  alignas(64) float sum[length] = {};
  for (const float* const band : bands) {
    for (int i = 0; i < length; ++i) sum[i] += band[i];
  }
  for (int i = 0; i < length; ++i) mean[i] = share * sum[i];
}

MALUS_SIMD_CLONES void disagreements(const AlignedRow& row, float* __restrict values) {
  const float share = 1.0F / static_cast<float>(row.bands.size() - 1);
  const float *const mean = row.mean, *const information = row.information;
  alignas(64) float sum[length] = {};
  for (const float* const band : row.bands) {
    for (int i = 0; i < length; ++i) sum[i] += (band[i] - mean[i]) * (band[i] - mean[i]);
  }
  for (int i = 0; i < length; ++i) values[i] = share * information[i] * sum[i];
}

MALUS_SIMD_CLONES void sum_row(const AlignedRow& row, float cauchy, RowSums& sums, float* __restrict weights) {
  alignas(64) float disagreement[length], gu[length] = {}, gv[length], x[length];
  disagreements(row, disagreement);
  const float *const mean = row.mean, *const above = row.mean_above, *const below = row.mean_below;
  const float *const information = row.information, x_first = row.x, x_step = row.x_step;
  for (int i = 0; i < length; ++i) weights[i] = information[i] / (1 + disagreement[i] / cauchy);
  for (int i = 1; i < length - 1; ++i) gu[i] = 0.5F * (mean[i + 1] - mean[i - 1]);
  for (int i = 0; i < length; ++i) gv[i] = 0.5F * (below[i] - above[i]);
  for (int i = 0; i < length; ++i) x[i] = x_first + x_step * static_cast<float>(i);

  float uu[3] = {}, uv[3] = {}, vv[3] = {};
  for (int i = 0; i < length; ++i) {
    const float wuu = weights[i] * gu[i] * gu[i], wuv = weights[i] * gu[i] * gv[i], wvv = weights[i] * gv[i] * gv[i];
    uu[0] += wuu, uu[1] += wuu * x[i], uu[2] += wuu * x[i] * x[i];
    uv[0] += wuv, uv[1] += wuv * x[i], uv[2] += wuv * x[i] * x[i];
    vv[0] += wvv, vv[1] += wvv * x[i], vv[2] += wvv * x[i] * x[i];
  }
  for (int m = 0; m < 3; ++m) {
    sums.gradients[0][m] = uu[m];
    sums.gradients[1][m] = uv[m];
    sums.gradients[2][m] = vv[m];
  }
  for (int i = 0; i < length; ++i) gu[i] *= weights[i];
  for (int i = 0; i < length; ++i) gv[i] *= weights[i];
  for (std::size_t k = 0; k < row.bands.size(); ++k) {
    const float* const band = row.bands[k];
    float u0 = 0, u1 = 0, v0 = 0, v1 = 0;
    for (int i = 0; i < length; ++i) {
      const float rest = mean[i] - band[i], along_u = rest * gu[i], along_v = rest * gv[i];
      u0 += along_u, u1 += along_u * x[i];
      v0 += along_v, v1 += along_v * x[i];
    }
    sums.sides[k] = {{u0, u1}, {v0, v1}};
  }
}

}  // namespace malus
