#include <algorithm>
#include <span>
#include <utility>

#include "malus/capture/registration_equations_internal.h"
#include "malus/capture/registration_rows_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"

namespace malus {
namespace {

/// Sums the equations over the blocks.
class EquationSums {
 public:
  EquationSums(const ComparedBands& compared, const RegistrationOptions& options, const Context& context)
      : options_(options),
        context_(context),
        size_(compared.contrast.information.size()),
        contrast_(compared.contrast),
        blocks_(compared.blocks),
        margin_(compared.margin) {}

  RegistrationEquations at(const std::vector<Affine>& maps, bool assess) const {
    const std::size_t count = maps.size();
    const PixelRect region = common_region(maps, size_, margin_);
    RegistrationEquations total(count);
    if (region.empty()) return total;
    const double cauchy = disagreement_scale(maps, region) * options_.cauchy_scale * options_.cauchy_scale;
    std::vector<RegistrationEquations> tiles(blocks_.size(), RegistrationEquations(count));
    for_blocks(region, [&](std::size_t tile, const PixelRect& part, AlignedRows& rows) {
      add_block(maps, part, cauchy, assess, rows, tiles[tile]);
    });
    for (RegistrationEquations& tile : tiles) {
      total.matrix += tile.matrix;
      total.of_noise += tile.of_noise;
      total.gradient_energy += tile.gradient_energy;
      total.noise_energy += tile.noise_energy;
      for (std::size_t k = 0; k < count; ++k) {
        total.sides[k] += tile.sides[k];
        total.products[k] += tile.products[k];
        total.others_energy[k] += tile.others_energy[k];
      }
      total.tile_sides.push_back(std::move(tile.sides));
    }
    return total;
  }

 private:
  /// Rows of a block in every aligned image and in the images' mean: rows × images × BlockRow::length.
  class AlignedRows {
   public:
    explicit AlignedRows(std::size_t images)
        : values_((images + 1) * (block_rows + 2) * BlockRow::length, 0.0F),
          information_(BlockRow::length),
          bands_(images) {}

    std::span<float> band(std::size_t k, int row) { return {at(k, row), BlockRow::length}; }
    float* mean(int row) { return at(bands_.size(), row); }
    float* information() { return information_.data(); }
    /// Pointers to a row in every image; valid until the next call.
    std::span<const float* const> bands(int row) {
      for (std::size_t k = 0; k < bands_.size(); ++k) bands_[k] = at(k, row);
      return bands_;
    }

   private:
    float* at(std::size_t k, int row) {
      return values_.data() + (k * (block_rows + 2) + static_cast<std::size_t>(row)) * BlockRow::length;
    }
    std::vector<float> values_, information_;
    std::vector<const float*> bands_;
  };

  /// Aligns row v of a region, with one more pixel on either side, in every image and in the images' mean.
  void align_row(const std::vector<Affine>& maps, const PixelRect& region, int v, int row, AlignedRows& rows) const {
    const auto count = static_cast<std::size_t>(region.u1 - region.u0 + 2);
    std::copy_n(contrast_.bands[0].row(v) + region.u0 - 1, count, rows.band(0, row).data());
    for (std::size_t k = 1; k < maps.size(); ++k) {
      resample_row(contrast_.bands[k], maps[k], region.u0 - 1, v, rows.band(k, row).first(count));
    }
    mean_row(rows.bands(row), rows.mean(row));
  }

  /// The row with its neighbors; pixels outside the region get no weight.
  AlignedRow aligned_row(const PixelRect& region, int v, int row, AlignedRows& rows) const {
    std::fill_n(rows.information(), BlockRow::length, 0.0F);
    std::copy(contrast_.information.row(v) + region.u0, contrast_.information.row(v) + region.u1,
              rows.information() + 1);
    const double width = size_.width, x = (region.u0 - 1 - 0.5 * (width - 1)) / width;
    return {rows.bands(row),    rows.mean(row),        rows.mean(std::max(row - 1, 0)), rows.mean(row + 1),
            rows.information(), static_cast<float>(x), static_cast<float>(1 / width)};
  }

  /// body(tile, block, rows) for the part of every block that all images show, tile by tile on several threads.
  template <class Body>
  void for_blocks(const PixelRect& region, Body&& body) const {
    parallel_for(context_, blocks_.size(), 1, [&](std::size_t tile, std::size_t) {
      AlignedRows rows(contrast_.bands.size());
      for (const RegistrationBlock& block : blocks_[tile]) {
        const PixelRect part = block.pixels.intersected(region);
        if (!part.empty()) body(tile, part, rows);
      }
    });
  }

  /// Lower quartile of the disagreement, which represents pixels whose contrast the polarizer hardly changes. Every
  /// eighth row of the blocks is enough for it. There are no values if maps have strayed so far that what all images
  /// show lies between the blocks of a large image.
  double disagreement_scale(const std::vector<Affine>& maps, const PixelRect& region) const {
    std::vector<std::vector<float>> parts(blocks_.size());
    for_blocks(region, [&](std::size_t tile, const PixelRect& part, AlignedRows& rows) {
      for (int v = part.v0; v < part.v1; v += 8) {
        align_row(maps, part, v, 0, rows);
        float values[BlockRow::length];
        disagreements(aligned_row(part, v, 0, rows), values);
        parts[tile].insert(parts[tile].end(), values + 1, values + 1 + (part.u1 - part.u0));
      }
    });
    std::vector<float> values;
    for (const std::vector<float>& part : parts) values.insert(values.end(), part.begin(), part.end());
    return std::max(static_cast<double>(of_rank_in_place(values, values.size() / 4)), 1e-4);
  }

  void add_block(const std::vector<Affine>& maps, const PixelRect& block, double cauchy, bool assess, AlignedRows& rows,
                 RegistrationEquations& sum) const {
    RowSums sums;
    sums.sides.resize(maps.size());
    float weights[BlockRow::length];
    for (int v = block.v0 - 1; v <= block.v1; ++v) align_row(maps, block, v, v - block.v0 + 1, rows);
    for (int v = block.v0; v < block.v1; ++v) {
      const AlignedRow row = aligned_row(block, v, v - block.v0 + 1, rows);
      sum_row(row, static_cast<float>(cauchy), sums, weights);
      const double y = (v - 0.5 * (size_.height - 1)) / size_.width;
      add_row(sums, y, sum);
      if (assess) add_assessment(row, v - block.v0 + 1, y, weights, rows, sum);
    }
  }

  /// Parameter i is the displacement along axis_of[i] times x^power_of_x[i] y^power_of_y[i].
  static constexpr int axis_of[] = {0, 1, 0, 0, 1, 1}, power_of_x[] = {0, 0, 1, 0, 1, 0},
                       power_of_y[] = {0, 0, 0, 1, 0, 1};

  /// Adds the products of gradients in row y to a matrix of normal equations.
  static void add_products(const double (&gradients)[3][3], double y, Matrix6& matrix) {
    const double y_to[] = {1, y, y * y};
    for (int i = 0; i < 6; ++i) {
      for (int j = 0; j < 6; ++j) {
        matrix(i, j) +=
            gradients[axis_of[i] + axis_of[j]][power_of_x[i] + power_of_x[j]] * y_to[power_of_y[i] + power_of_y[j]];
      }
    }
  }

  /// Adds the sums of row y to the normal equations of g_u, g_v, g_u x, g_u y, g_v x, g_v y.
  static void add_row(const RowSums& row, double y, RegistrationEquations& sum) {
    add_products(row.gradients, y, sum.matrix);
    const double y_to[] = {1, y};
    for (int i = 0; i < 6; ++i) {
      for (std::size_t k = 0; k < row.sides.size(); ++k) {
        const RowSums::Side& side = row.sides[k];
        sum.sides[k][i] += (axis_of[i] == 0 ? side.along_u : side.along_v)[power_of_x[i]] * y_to[power_of_y[i]];
      }
    }
  }

  /// Adds the gradient energy of the mean image, the part of it that the images' disagreement explains, and each
  /// image's regression on the others.
  static void add_assessment(const AlignedRow& row, int index, double y, const float* weights, AlignedRows& rows,
                             RegistrationEquations& sum) {
    const auto count = static_cast<double>(row.bands.size());
    double noise_products[3][3] = {};
    for (std::size_t i = 1; i + 1 < BlockRow::length; ++i) {
      const double weight = weights[i];
      const double gu = 0.5 * (row.mean[i + 1] - row.mean[i - 1]), gv = 0.5 * (row.mean_below[i] - row.mean_above[i]);
      double noise[3] = {};
      for (std::size_t k = 0; k < row.bands.size(); ++k) {
        const float *const here = row.bands[k], *const above = rows.band(k, index - 1).data(),
                           *const below = rows.band(k, index + 1).data();
        const double ru = 0.5 * ((here[i + 1] - row.mean[i + 1]) - (here[i - 1] - row.mean[i - 1]));
        const double rv = 0.5 * ((below[i] - row.mean_below[i]) - (above[i] - row.mean_above[i]));
        noise[0] += ru * ru, noise[1] += ru * rv, noise[2] += rv * rv;
        const double others = (count * row.mean[i] - here[i]) / (count - 1);
        sum.products[k] += weight * others * here[i];
        sum.others_energy[k] += weight * others * others;
      }
      sum.gradient_energy += weight * (gu * gu + gv * gv);
      const double of_mean = weight / (count * (count - 1)), x = row.x + static_cast<float>(i) * row.x_step;
      sum.noise_energy += of_mean * (noise[0] + noise[2]);
      for (int product = 0; product < 3; ++product) {
        for (int power = 0; power < 3; ++power)
          noise_products[product][power] += of_mean * noise[product] * (power == 0 ? 1 : power == 1 ? x : x * x);
      }
    }
    add_products(noise_products, y, sum.of_noise);
  }

  const RegistrationOptions& options_;
  const Context& context_;
  Size size_;
  const ContrastBands& contrast_;
  const std::vector<std::vector<RegistrationBlock>>& blocks_;
  int margin_;
};

}  // namespace

RegistrationEquations registration_equations(const ComparedBands& compared, const std::vector<Affine>& maps,
                                             bool assess, const RegistrationOptions& options, const Context& context) {
  return EquationSums(compared, options, context).at(maps, assess);
}

}  // namespace malus
