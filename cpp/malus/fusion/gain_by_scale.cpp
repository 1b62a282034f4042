#include <algorithm>
#include <cmath>

#include "malus/core/masked_blur_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/square_internal.h"
#include "malus/fusion/gain_by_scale_internal.h"
#include "malus/fusion/refinement_weights_internal.h"

namespace malus {
namespace {

/// Smoothing length of a mean over a cell: the standard deviation of a uniform distribution over it.
double smoothing_of_cells(int cell_px) {
  return cell_px / std::sqrt(12.0);
}

/// Weight of the pixels of a cell that makes their products those of degrees of polarization. A highlight is a hundred
/// times as bright as its neighbors, and its products would count ten thousand times as much.
double unit_of_degrees(const RefinementField& part, const PixelRect& cell) {
  double s0 = 0;
  int count = 0;
  for_each_pixel(cell, part.usable, [&](int u, int v) {
    s0 += part.s0(u, v);
    ++count;
  });
  return s0 > 0 ? square(count / s0) : 0;
}

/// Factor that scales s0 of a metal, which its surface must explain, too, to the unit of (s1, s2); 0 for a dielectric.
double weight_of_s0(const RefinementField& part, int u, int v) {
  const double error = part.reflection.metal_error * part.s0(u, v), precision = part.stokes_precision(u, v);
  return error > 0 && precision > 0 ? 1 / (error * std::sqrt(precision)) : 0;
}

Image<float> summed_nearby(const Image<float>& sums, const Context& context) {
  constexpr double region_cells = 1.5;
  return masked_blur(sums, Mask(sums.size(), 1, 255), region_cells, context);
}

}  // namespace

GainByScale::GainByScale(Size image, bool of_metal, double noise_share)
    : of_metal_(of_metal), noise_share_(noise_share), cells_(cells_over(image, finest_px)), within_(cells_.size()) {}

void GainByScale::Products::add(std::size_t cell, double weight, const Stokes& change, const Stokes& rest,
                                double noise) {
  nn[cell] += static_cast<float>(weight * noise);
  dd[cell] += static_cast<float>(weight * change.dot(change));
  dr[cell] += static_cast<float>(weight * change.dot(rest));
  rr[cell] += static_cast<float>(weight * rest.dot(rest));
}

void GainByScale::add(const RefinementField& part, RowRange rows, int first_row, const Context& context) {
  struct Pixel {
    double weight, noise;
    Stokes change, rest;
  };
  const auto add_cell = [&](int column, int row, const PixelRect& of_cell) {
    std::vector<Pixel> pixels;
    pixels.reserve(static_cast<std::size_t>(finest_px * finest_px));
    Cell cell;
    const double unit = unit_of_degrees(part, of_cell);
    for_each_pixel(of_cell, part.usable, [&](int u, int v) {
      const double weight = unit * stokes_weight(part, u, v), noise = 2 * noise_share_ * part.variance(u, v);
      const Slopes slopes = central_slopes(part, u, v), before = central_slopes(part, part.x_prior, u, v);
      const PixelReflection reflection = part.reflection_at(u, v);
      const PredictedStokes result = reflection.predict(slopes.p, slopes.q);
      const PredictedStokes prior = reflection.predict(before.p, before.q);
      const double of_s0 = weight_of_s0(part, u, v);
      const Stokes change{result.s1 - prior.s1, result.s2 - prior.s2, of_s0 * (result.mirrored - prior.mirrored)};
      const Stokes rest{part.s1(u, v) - result.s1, part.s2(u, v) - result.s2,
                        of_s0 * (part.s0(u, v) - result.mirrored)};
      pixels.push_back({weight, noise, change, rest});
      cell.weight += weight;
      cell.noise += square(weight) * noise;
      cell.change += change * weight;
      cell.rest += rest * weight;
    });
    if (cell.weight <= 0) return;
    const Stokes mean_change = cell.change / cell.weight, mean_rest = cell.rest / cell.weight;
    const std::size_t index = cells_.size().index(column, row);
    for (const Pixel& pixel : pixels)
      within_.add(index, pixel.weight, pixel.change - mean_change, pixel.rest - mean_rest,
                  pixel.noise * (1 - pixel.weight / cell.weight));
    cells_[index] += cell;
  };
  for_each_cell(finest_px, part.size().width, rows, first_row, context, add_cell);
}

GainByScale::Gains::Scale GainByScale::gain_of(const Products& products, int cell_px, double of_rest,
                                               const Context& context) {
  const Image<float> dds = summed_nearby(products.dd, context), drs = summed_nearby(products.dr, context),
                     rrs = summed_nearby(products.rr, context), nns = summed_nearby(products.nn, context);
  Gains::Scale scale{cell_px, Image<float>(dds.size())};
  for (std::size_t i = 0; i < dds.count(); ++i) {
    const double dd = dds[i], dr = drs[i], rr = rrs[i];
    if (dd <= 0) {
      scale.gain[i] = 1;  // no movement
    } else if (dd + dr > 0) {
      const double h = dd / (dd + dr);
      // A surface that follows the noise exactly leaves none of it.
      const double across = std::max(rr - square(dr) / dd, static_cast<double>(nns[i])) / (dd / square(h));
      scale.gain[i] = static_cast<float>(std::clamp((1 - of_rest * across) / h, 0.0, 1.0));
    }
  }
  return scale;
}

Image<GainByScale::Cell> GainByScale::parents_of(const Image<Cell>& cells) {
  Image<Cell> parents({(cells.width() + 1) / 2, (cells.height() + 1) / 2});
  for_each_pixel(cells.size(), [&](int u, int v) { parents(u / 2, v / 2) += cells(u, v); });
  return parents;
}

GainByScale::Gains GainByScale::gains(const Context& context) const {
  constexpr double half = 0.5;
  const double of_pixels = of_metal_ ? half : 0.25;
  Gains gains;
  // All scales together on the raster of 16 px.
  constexpr int all_px = 16;
  const Size all_cells = cells_over({cells_.width() * finest_px, cells_.height() * finest_px}, all_px);
  Image<float> gained(all_cells), changed(all_cells);
  const auto take = [&](const Products& products, int cell_px, double of_rest) {
    gains.scales.push_back(gain_of(products, cell_px, of_rest, context));
    const Image<float>& gain = gains.scales.back().gain;
    const double pixels = square(static_cast<double>(cell_px));
    const Image<float> nearby = summed_nearby(products.dd, context);
    for_each_pixel(all_cells, [&](int u, int v) {
      const int x = u * all_px + all_px / 2, y = v * all_px + all_px / 2;
      const double change = between_cells(nearby, cell_px, x, y) / pixels;
      changed(u, v) += static_cast<float>(change);
      gained(u, v) += static_cast<float>(change * between_cells(gain, cell_px, x, y));
    });
  };
  take(within_, finest_px, of_pixels);
  Image<Cell> cells = cells_;
  for (int cell_px = finest_px; cell_px <= coarsest_px; cell_px *= 2) {
    const bool is_last = cell_px == coarsest_px;
    const Image<Cell> parents = is_last ? cells : parents_of(cells);
    Products products(parents.size());
    for_each_pixel(cells.size(), [&](int u, int v) {
      const Cell& cell = cells(u, v);
      if (cell.weight <= 0) return;
      const int column = is_last ? u : u / 2, row = is_last ? v : v / 2;
      const Cell& parent = parents(column, row);
      Stokes change = cell.change / cell.weight, rest = cell.rest / cell.weight;
      // The means of the largest cells have no coarser mean to subtract.
      if (!is_last) {
        change -= parent.change / parent.weight;
        rest -= parent.rest / parent.weight;
      }
      const double own = is_last ? 1 : 1 - cell.weight / parent.weight;
      products.add(parents.size().index(column, row), cell.weight, change, rest,
                   own * cell.noise / square(cell.weight));
    });
    take(products, is_last ? cell_px : 2 * cell_px, half);
    cells = parents;
  }
  for (std::size_t i = 0; i < gained.count(); ++i) gained[i] = changed[i] > 0 ? gained[i] / changed[i] : 1;
  gains.all = {all_px, std::move(gained)};
  return gains;
}

Image<float> movement_that_is_gain(const RefinementImage& image, const Image<double>& x_prior,
                                   const GainByScale::Gains& gains, const Context& context) {
  const Size size = image.size();
  Image<float> finer(size), gained(size);
  for (std::size_t i = 0; i < finer.count(); ++i)
    finer[i] = image.object[i] ? static_cast<float>(image.x[i] - x_prior[i]) : 0.0F;
  double smoothed_px = 0;
  int cell_px = gains.scales.front().cell_px;
  for (std::size_t k = 0; k < gains.scales.size(); ++k, cell_px *= 2) {
    const GainByScale::Gains::Scale& scale = gains.scales[k];
    const double next_px = smoothing_of_cells(cell_px);
    const bool is_last = k + 1 == gains.scales.size();
    const Image<float> coarser =
        is_last ? Image<float>(size)
                : masked_blur(finer, image.object, std::sqrt(square(next_px) - square(smoothed_px)), context);
    parallel_pixels(context, image.object, [&](int u, int v) {
      const double gain = between_cells(scale.gain, scale.cell_px, u, v);
      gained(u, v) += static_cast<float>(gain * (finer(u, v) - coarser(u, v)));
    });
    finer = coarser;
    smoothed_px = next_px;
  }
  return gained;
}

}  // namespace malus
