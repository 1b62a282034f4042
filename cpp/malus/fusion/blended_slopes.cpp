#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "malus/core/cell_values_internal.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/masked_blur_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/core/square_internal.h"
#include "malus/fusion/blended_slopes_internal.h"
#include "malus/linalg/grid_solver_internal.h"

namespace malus {
namespace {

/// Means over the object's pixels of each cell; trust is NaN beside the object.
struct BlendedCells {
  Image<double> movement;
  Image<float> trust, variance;  ///< variance: of the prior
  Mask known;
};

BlendedCells blended_cells(const RefinementImage& image, const Image<double>& x_prior, const Image<float>& trust,
                           int cell_px, const Context& context) {
  const Size size = image.size(), count = cells_over(size, cell_px);
  BlendedCells cells{Image<double>(count), Image<float>(count, 1, no_value), Image<float>(count), Mask(count)};
  parallel_pixels(context, count, [&](int column, int row) {
    double movement = 0, trusts = 0, variance = 0;
    int nodes = 0;
    for_each_pixel(cell_rect(column, row, cell_px, size), image.object, [&](int u, int v) {
      movement += image.x(u, v) - x_prior(u, v);
      trusts += trust(u, v);
      variance += square(image.source(u, v).prior_sigma);
      ++nodes;
    });
    if (nodes == 0) return;
    cells.movement(column, row) = movement / nodes;
    cells.trust(column, row) = static_cast<float>(trusts / nodes);
    cells.variance(column, row) = static_cast<float>(variance / nodes);
    cells.known(column, row) = 255;
  });
  return cells;
}

/// The correction in each cell of the object; NaN beside it.
Image<float> correction(const BlendedCells& cells, int cell_px, const Context& context) {
  constexpr double slope_error = 0.05;  // of the prior and of the refined surface
  constexpr float least_variance = 1e-12F;
  const PixelIndex pixels(cells.known);
  GridSystem system(pixels);
  const auto add_slope = [&](int a, int u, int v) {
    const int b = pixels.at(u, v);
    if (b < 0) return;
    const int ends[] = {a, b};
    const double difference[] = {-1, 1};
    const int from_u = pixels.u(a), from_v = pixels.v(a);
    const double movement = 0.5 * (cells.movement(from_u, from_v) + cells.movement(u, v));
    system.add_row(ends, difference, 2, -movement * (cells.trust(u, v) - cells.trust(from_u, from_v)), 1);
  };
  for (int a = 0; a < pixels.count(); ++a) {
    system.add(a, a,
               square(slope_error * cell_px) / std::max(cells.variance(pixels.u(a), pixels.v(a)), least_variance));
    add_slope(a, pixels.u(a) + 1, pixels.v(a));
    add_slope(a, pixels.u(a), pixels.v(a) + 1);
  }
  Eigen::VectorXd solution;
  Image<float> result(cells.known.size(), 1, no_value);
  if (GridSolver(pixels, context).solve(system, 0, solution) != SolveStatus::solved) {
    context.log(LogLevel::warning, "the slopes of the surface and its prior could not be blended: there may be steps");
    solution = Eigen::VectorXd::Zero(pixels.count());
  }
  for (int a = 0; a < pixels.count(); ++a) result(pixels.u(a), pixels.v(a)) = static_cast<float>(solution[a]);
  return result;
}

/// Gives cells beside the object, which are NaN, the values of their neighbors on it, for the interpolation at its rim.
void continue_beside(Image<float>& cells, const Context& context) {
  const Image<float> beside = masked_blur(cells, Mask(cells.size(), 1, 255), 0.5, context);
  for (std::size_t i = 0; i < cells.count(); ++i) {
    if (std::isnan(cells[i])) cells[i] = beside[i];
  }
}

}  // namespace

void blend_slopes(RefinementImage& image, const Image<double>& x_prior, const Image<float>& trust,
                  const Context& context, std::ptrdiff_t most_cells) {
  int cell_px = 1;
  while (count_of_set(image.object) > most_cells * cell_px * cell_px) cell_px *= 2;
  // Trust is interpolated between the cells, too: then the correction's slopes fit its slopes.
  BlendedCells cells = blended_cells(image, x_prior, trust, cell_px, context);
  Image<float> change = correction(cells, cell_px, context);
  continue_beside(change, context);
  continue_beside(cells.trust, context);
  parallel_pixels(context, image.object, [&](int u, int v) {
    const double moved = image.x(u, v) - x_prior(u, v);
    image.x(u, v) =
        x_prior(u, v) + between_cells(cells.trust, cell_px, u, v) * moved + between_cells(change, cell_px, u, v);
  });
}

}  // namespace malus
