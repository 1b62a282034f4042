#include <algorithm>
#include <cmath>

#include "malus/core/masked_blur_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/core/square_internal.h"
#include "malus/fusion/anchor_internal.h"
#include "malus/fusion/slow_waves_internal.h"
#include "malus/fusion/surface_evidence_internal.h"

namespace malus {

void shrink_slow_waves(RefinementImage& image, const Image<double>& x_prior, double smoothing_px,
                       const Context& context) {
  constexpr double around = 2;  // mean squares are taken over so many lengths of the waves
  const double wave_px = waves_of_prior * smoothing_px;
  // Cells save time and memory, and are small compared with the waves.
  int cell_px = 1;
  while (4 * cell_px <= wave_px) cell_px *= 2;
  const Size size = image.size(), count = cells_over(size, cell_px);
  // Cells beside the object continue their neighbors.
  const Mask all(count, 1, 255);
  Image<float> slow(count, 1, no_value), variance(count, 1, no_value);
  parallel_pixels(context, count, [&](int column, int row) {
    double sum = 0, variances = 0;
    int nodes = 0;
    for_each_pixel(cell_rect(column, row, cell_px, size), image.object, [&](int u, int v) {
      sum += image.x(u, v) - x_prior(u, v);
      variances += square(image.source(u, v).prior_sigma);
      ++nodes;
    });
    if (nodes == 0) return;
    slow(column, row) = static_cast<float>(sum / nodes);
    variance(column, row) = static_cast<float>(variances / nodes);
  });
  // Averaging over cells and interpolating between them already smooths by a variance of a quarter of a squared cell.
  slow = masked_blur(slow, all, std::sqrt(square(wave_px) - 0.25 * square(cell_px)) / cell_px, context);
  Image<float> squares(count), too_much(count);
  for (std::size_t i = 0; i < squares.count(); ++i) squares[i] = square(slow[i]) / variance[i];
  squares = masked_blur(squares, all, around * wave_px / cell_px, context);
  for (std::size_t i = 0; i < squares.count(); ++i) too_much[i] = (1 - 1 / std::max(squares[i], 1.0F)) * slow[i];
  parallel_pixels(context, image.object,
                  [&](int u, int v) { image.x(u, v) -= between_cells(too_much, cell_px, u, v); });
}

}  // namespace malus
