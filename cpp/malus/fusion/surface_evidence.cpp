#include <algorithm>
#include <cmath>
#include <vector>

#include "malus/core/masked_blur_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/square_internal.h"
#include "malus/fusion/surface_evidence_internal.h"

namespace malus {
namespace {

/// Weighted Gaussian mean of cells; 0 where no cell with weight is near.
Image<float> pooled(const Image<float>& values, const Image<float>& weights, double sigma_cells,
                    const Context& context) {
  const Mask all(values.size(), 1, 255);
  Image<float> products(values.size());
  for (std::size_t i = 0; i < values.count(); ++i) products[i] = weights[i] * values[i];
  Image<float> means = masked_blur(products, all, sigma_cells, context);
  const Image<float> counts = masked_blur(weights, all, sigma_cells, context);
  for (std::size_t i = 0; i < means.count(); ++i) means[i] = counts[i] > 0 ? means[i] / counts[i] : 0;
  return means;
}

constexpr double fill_cells = 0.5;  // cells without usable pixels follow their neighbors

}  // namespace

ExplainedPolarization::ExplainedPolarization(Size image, const Eigen::Vector3d& mean_normal)
    : cells_(cells_over(image, cell_px)), mean_normal_(mean_normal) {}

void ExplainedPolarization::add(const RefinementField& part, RowRange rows, int first_row, const Context& context) {
  const auto add_cell = [&](int column, int row, const PixelRect& pixels) {
    Cell& cell = cells_(column, row);
    for_each_pixel(pixels, part.usable, [&](int u, int v) {
      const Slopes slopes = central_slopes(part, u, v);
      const RayFrame frame = part.frame_at(u, v);
      const PixelReflection reflection = part.reflection_at(u, v, frame);
      const PredictedStokes model = reflection.predict(slopes.p, slopes.q);
      const Slopes flat = frame.slopes(mean_normal_);
      const PredictedStokes plane = reflection.predict(flat.p, flat.q);
      cell.measured += Eigen::Vector2d(part.s1(u, v), part.s2(u, v));
      cell.model += Eigen::Vector2d(model.s1, model.s2);
      cell.plane += Eigen::Vector2d(plane.s1, plane.s2);
      ++cell.pixels;
    });
  };
  for_each_cell(cell_px, part.size().width, rows, first_row, context, add_cell);
}

Image<float> ExplainedPolarization::shares(bool beyond_a_plane, const Context& context) const {
  constexpr int full = cell_px * cell_px, fewest = full / 4;
  constexpr double pool_cells = 2;
  Image<float> shares(cells_.size()), weights(cells_.size());
  for (std::size_t i = 0; i < cells_.count(); ++i) {
    const Cell& cell = cells_[i];
    const double rest = (cell.measured - cell.model).squaredNorm(), known = beyond_a_plane ? 1 : 0;
    const double all = (cell.measured - known * cell.plane).squaredNorm();
    if (cell.pixels < fewest || rest + all <= 0) continue;
    shares[i] = static_cast<float>(1 - 2 * rest / (rest + all));
    weights[i] = static_cast<float>(cell.pixels) / full;
  }
  return pooled(shares, weights, pool_cells, context);
}

ExplainedByResult::ExplainedByResult(Size image)
    : shares_(cells_over(image, ExplainedPolarization::cell_px)), pixels_(shares_.size()) {}

void ExplainedByResult::add(const RefinementField& part, RowRange rows, int first_row, const Context& context) {
  constexpr int cell_px = ExplainedPolarization::cell_px;
  constexpr std::size_t fewest = 20;
  const auto add_cell = [&](int column, int row, const PixelRect& pixels) {
    std::vector<double> rests, all;
    for_each_pixel(pixels, part.usable, [&](int u, int v) {
      const Slopes slopes = central_slopes(part, u, v);
      const PredictedStokes model = part.reflection_at(u, v).predict(slopes.p, slopes.q);
      rests.push_back(std::hypot(part.s1(u, v) - model.s1, part.s2(u, v) - model.s2));
      all.push_back(std::hypot(part.s1(u, v), part.s2(u, v)));
    });
    if (rests.size() < fewest) return;
    const auto share = static_cast<float>(1 - median_in_place(rests) / std::max(median_in_place(all), 1e-12));
    // Two parts can share a row of cells: each of them then counts by its pixels.
    const float before = pixels_(column, row), here = static_cast<float>(rests.size());
    float& mean = shares_(column, row);
    mean = before > 0 ? (before * mean + here * share) / (before + here) : share;
    pixels_(column, row) = before + here;
  };
  for_each_cell(cell_px, part.size().width, rows, first_row, context, add_cell);
}

Image<float> ExplainedByResult::shares(const Context& context) const {
  Image<float> weights(pixels_.size());
  for (std::size_t i = 0; i < weights.count(); ++i) weights[i] = pixels_[i] > 0 ? 1.0F : 0.0F;
  return pooled(shares_, weights, fill_cells, context);
}

void anchor_to_prior(RefinementImage& image, const Image<double>& x_prior, double length_px, const Context& context) {
  if (length_px <= 0) return;
  // Cells save time, and need not be smaller than the length.
  int cell_px = prior_block_px;
  while (cell_px > length_px && cell_px > 1) cell_px /= 2;
  // Averaging over cells and interpolating between them already smooths by a variance of a quarter of a squared cell.
  const double rest2 = square(std::max(length_px, static_cast<double>(cell_px))) - 0.25 * square(cell_px);
  const Size size = image.size(), count = cells_over(size, cell_px);
  Image<float> lack(count), weights(count);
  parallel_pixels(context, count, [&](int column, int row) {
    double sum = 0, variance = 0;
    int nodes = 0;
    for_each_pixel(cell_rect(column, row, cell_px, size), image.object, [&](int u, int v) {
      sum += x_prior(u, v) - image.x(u, v);
      variance += std::pow(image.source(u, v).prior_sigma, 2);
      ++nodes;
    });
    if (nodes == 0) return;
    lack(column, row) = static_cast<float>(sum / nodes);
    weights(column, row) = static_cast<float>(nodes / std::max(variance / nodes, 1e-12));
  });
  const Image<float> low = pooled(lack, weights, std::sqrt(rest2) / cell_px, context);
  parallel_pixels(context, image.object, [&](int u, int v) { image.x(u, v) += between_cells(low, cell_px, u, v); });
}

Image<float> deviations_from_prior(const RefinementImage& image, const Image<double>& x_prior, const Context& context) {
  constexpr int cell_px = ExplainedPolarization::cell_px;
  constexpr double pool_cells = 0.5;
  const Size size = image.size(), count = cells_over(size, cell_px);
  Image<float> squares(count), weights(count);
  parallel_pixels(context, count, [&](int column, int row) {
    for_each_pixel(cell_rect(column, row, cell_px, size), image.object, [&](int u, int v) {
      const double deviation = (image.x(u, v) - x_prior(u, v)) / image.source(u, v).prior_sigma;
      squares(column, row) += static_cast<float>(square(deviation));
      weights(column, row) += 1;
    });
  });
  for (std::size_t i = 0; i < squares.count(); ++i) squares[i] /= std::max(weights[i], 1.0F);
  Image<float> deviations = pooled(squares, weights, pool_cells, context);
  for (float& value : deviations) value = std::sqrt(value);
  return deviations;
}

}  // namespace malus
