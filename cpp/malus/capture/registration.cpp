#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <sstream>

#include "malus/capture/contrast_band_internal.h"
#include "malus/capture/registration_internal.h"
#include "malus/capture/registration_rows_internal.h"
#include "malus/core/digits_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"

namespace malus {
namespace {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

constexpr int smallest_side_px = 48;
constexpr int coarsest_side_px = 110;
constexpr int tiles_across = 12, tiles_down = 8;
constexpr double step_limit_px = 4;
constexpr double coarse_tolerance_px = 0.01, fine_tolerance_px = 1e-3;
/// Largest number of pixels compared on one level.
constexpr std::size_t most_pixels = std::size_t{2} << 20;
/// Distance from the image's border [px] for interpolation and gradients.
constexpr int interpolation_margin = 4;
/// Least share of the gradients' energy that must be texture and not noise.
constexpr double least_texture = 0.1;
/// Moves that leave less than this share of the texture that the images have in common unmoved are wrong.
constexpr double least_kept_texture = 0.5;
/// Least regression of an image's band on the others' that still counts as the same scene.
constexpr double least_similarity = 0.25;

Image<float> half_size(const Image<float>& image) {
  auto half = Image<float>::uninitialized({(image.width() + 1) / 2, (image.height() + 1) / 2});
  cv::Mat out = as_mat(half);
  cv::pyrDown(as_mat(image), out, out.size());
  return half;
}

/// Displacement p(x) = (p0 + p2 x + p3 y, p1 + p4 x + p5 y), x and y from the center in units of the width.
Affine displaced(const Affine& map, const Vector6& p, Size size) {
  const double w = size.width, cu = 0.5 * (size.width - 1), cv = 0.5 * (size.height - 1);
  Eigen::Matrix2d linear = Eigen::Matrix2d::Identity();
  linear(0, 0) += p[2] / w;
  linear(0, 1) += p[3] / w;
  linear(1, 0) += p[4] / w;
  linear(1, 1) += p[5] / w;
  const Eigen::Vector2d shift(p[0] - (p[2] * cu + p[3] * cv) / w, p[1] - (p[4] * cu + p[5] * cv) / w);
  Affine result;
  result.leftCols<2>() = map.leftCols<2>() * linear;
  result.col(2) = map.leftCols<2>() * shift + map.col(2);
  return result;
}

std::array<Eigen::Vector2d, 5> corners_and_center(Size size) {
  const double right = size.width - 1, bottom = size.height - 1;
  return {{{0, 0}, {right, 0}, {0, bottom}, {right, bottom}, {0.5 * right, 0.5 * bottom}}};
}

/// Mean square of the displacement over corners and center, for a covariance (or outer product) of the parameters.
double mean_square_displacement(const Matrix6& covariance, Size size) {
  const double w = size.width;
  double sum = 0;
  for (const Eigen::Vector2d& corner : corners_and_center(size)) {
    const double x = (corner.x() - 0.5 * (size.width - 1)) / w, y = (corner.y() - 0.5 * (size.height - 1)) / w;
    Vector6 along_u, along_v;
    along_u << 1, 0, x, y, 0, 0;
    along_v << 0, 1, 0, 0, x, y;
    sum += along_u.dot(covariance * along_u) + along_v.dot(covariance * along_v);
  }
  return sum / 5;
}

/// Pixels whose band is free of border effects in every image.
PixelRect common_region(const std::vector<Affine>& maps, Size size, int margin) {
  double left = 0, top = 0, right = 0, bottom = 0;
  for (const Affine& map : maps) {
    for (const Eigen::Vector2d& corner : corners_and_center(size)) {
      const Eigen::Vector2d moved = map.leftCols<2>() * corner + map.col(2) - corner;
      left = std::max(left, -moved.x());
      top = std::max(top, -moved.y());
      right = std::max(right, moved.x());
      bottom = std::max(bottom, moved.y());
    }
  }
  const auto reach = [&](double outside) { return static_cast<int>(std::min(std::ceil(outside), 1e6)) + margin; };
  return {reach(left), reach(top), size.width - reach(right), size.height - reach(bottom)};
}

/// A part of the image that is processed at once, small enough for a processor's cache.
struct Block {
  PixelRect pixels;
  double energy = 0;  ///< of the texture
};
constexpr int block_rows = 32;

/// Blocks of each tile; the uncertainty is estimated from the scatter between tiles. A small image uses all blocks. A
/// large one uses those with most texture in each tile, up to `most_pixels`: more blocks would only improve an estimate
/// that is already far more precise than needed.
std::vector<std::vector<Block>> choose_blocks(const ContrastBands& contrast, const Context& context) {
  const Size size = contrast.information.size();
  const Image<float>& band = contrast.bands[0];
  std::vector<std::vector<Block>> tiles(tiles_across * tiles_down);
  for (int v = 0; v < size.height; v += block_rows) {
    for (int u = 0; u < size.width; u += BlockRow::columns) {
      const PixelRect pixels{u, v, std::min(u + BlockRow::columns, size.width), std::min(v + block_rows, size.height)};
      const long column = static_cast<long>(pixels.u0 + pixels.u1) * tiles_across / (2 * size.width);
      const long row = static_cast<long>(pixels.v0 + pixels.v1) * tiles_down / (2 * size.height);
      tiles[static_cast<std::size_t>(row * tiles_across + column)].push_back({pixels});
    }
  }
  const double share = static_cast<double>(most_pixels) / static_cast<double>(size.area());
  if (share >= 1) return tiles;
  parallel_for(context, tiles.size(), 1, [&](std::size_t t, std::size_t) {
    std::vector<Block>& blocks = tiles[t];
    for (Block& block : blocks) {
      for (int v = block.pixels.v0 + 1; v < block.pixels.v1 - 1; v += 4) {
        for (int u = block.pixels.u0 + 1; u < block.pixels.u1 - 1; ++u) {
          const float gu = band(u + 1, v) - band(u - 1, v), gv = band(u, v + 1) - band(u, v - 1);
          block.energy += static_cast<double>(contrast.information(u, v) * (gu * gu + gv * gv));
        }
      }
    }
    std::stable_sort(blocks.begin(), blocks.end(), [](const Block& a, const Block& b) { return a.energy > b.energy; });
    blocks.resize(static_cast<std::size_t>(std::ceil(share * static_cast<double>(blocks.size()))));
  });
  return tiles;
}

/// One level of the pyramid: the bands of all images, and the steps towards their maps.
class Level {
 public:
  /// quarters: the images two levels up the pyramid, or nothing.
  Level(const std::vector<Image<float>>& images, const std::vector<Image<float>>& quarters, const NoiseModel& noise,
        const RegistrationOptions& options, const Context& context)
      : options_(options),
        context_(context),
        size_(images[0].size()),
        contrast_(contrast_bands(images, quarters, {options.fine_sigma_px, options.coarse_sigma_px}, noise, context)),
        blocks_(choose_blocks(contrast_, context)) {
    const int band_margin = static_cast<int>(std::lround(1.5 * options.coarse_sigma_px));
    margin_ = std::max(std::min(band_margin, std::min(size_.width, size_.height) / 8), interpolation_margin);
  }

  /// Gauss–Newton from the given maps; returns the last step's largest displacement [px].
  double solve(std::vector<Affine>& maps, double tolerance_px) const {
    double step_px = 0;
    for (int iteration = 0; iteration < options_.max_iterations; ++iteration) {
      step_px = step(maps);
      if (!(step_px > tolerance_px)) break;
    }
    return step_px;
  }

  /// Translation of image k by phase correlation, if it correlates better with the first image than no translation
  /// does.
  Affine phase_correlation(std::size_t k) const {
    Affine shifted = identity_affine();
    cv::Mat window;
    cv::createHanningWindow(window, {size_.width, size_.height}, CV_32F);
    // Copies: OpenCV 4.6 applies the window to its inputs in place when their size needs no padding.
    const Image<float>& unmoved = contrast_.bands[k];
    const cv::Point2d shift = cv::phaseCorrelate(as_mat(contrast_.bands[0]).clone(), as_mat(unmoved).clone(), window);
    shifted.col(2) = Eigen::Vector2d(shift.x, shift.y);
    const double limit = options_.max_shift * size_.width;
    if (!(shifted.col(2).norm() <= limit)) return identity_affine();
    return correlation(unmoved, shifted) > correlation(unmoved, identity_affine()) ? shifted : identity_affine();
  }

  /// Uncertainty, texture and similarity at the given maps; RegistrationFigures explains them.
  struct Assessment {
    std::vector<double> rms_px, similarity;
    double texture = 0, unmoved_texture = 0;
  };
  Assessment assess(const std::vector<Affine>& maps) const {
    const Normals normals = normal_equations(maps, true);
    Assessment result{std::vector<double>(maps.size()), std::vector<double>(maps.size()), normals.texture(), 0};
    const std::optional<Matrix6> inverse = inverse_without_noise(normals);
    for (std::size_t k = 1; k < maps.size(); ++k) {
      Matrix6 scatter = Matrix6::Zero();
      for (const auto& tile : normals.tile_sides) {
        const Vector6 difference = tile[k] - tile[0];
        scatter += difference * difference.transpose();
      }
      result.rms_px[k] = inverse ? std::sqrt(mean_square_displacement(*inverse * scatter * *inverse, size_))
                                 : std::numeric_limits<double>::infinity();
      result.similarity[k] = normals.others_energy[k] > 0 ? normals.products[k] / normals.others_energy[k] : 0;
    }
    const bool are_known =
        std::ranges::all_of(result.rms_px, [this](double rms_px) { return rms_px <= options_.max_uncertainty_px; });
    if (!are_known || !(result.texture >= least_texture)) {
      const std::vector<Affine> unmoved(maps.size(), identity_affine());
      result.unmoved_texture = normal_equations(unmoved, true).texture();
    }
    return result;
  }

 private:
  struct Normals {
    Matrix6 matrix = Matrix6::Zero();
    Matrix6 of_noise = Matrix6::Zero();  ///< the part of `matrix` that the images' disagreement explains
    std::vector<Vector6> sides;
    std::vector<std::vector<Vector6>> tile_sides;
    double gradient_energy = 0, noise_energy = 0;
    std::vector<double> products, others_energy;

    explicit Normals(std::size_t images)
        : sides(images, Vector6::Zero()), products(images, 0.0), others_energy(images, 0.0) {}

    double texture() const { return gradient_energy > 0 ? 1 - noise_energy / gradient_energy : 0; }
  };

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

  /// Inverse of the normal equations that the images' common texture alone gives: gradients of noise say nothing of a
  /// displacement. None if in some direction nearly all of the gradients are noise, as for lines of one direction.
  static std::optional<Matrix6> inverse_without_noise(const Normals& normals) {
    const Eigen::GeneralizedSelfAdjointEigenSolver<Matrix6> shares(normals.of_noise, normals.matrix);
    if (shares.info() != Eigen::Success || !(1 - shares.eigenvalues().maxCoeff() >= least_texture)) return std::nullopt;
    return (normals.matrix - normals.of_noise).ldlt().solve(Matrix6::Identity());
  }

  double correlation(const Image<float>& image, const Affine& map) const {
    const PixelRect region = common_region({map}, size_, margin_);
    if (region.empty()) return 0;
    double ab = 0, bb = 0;
    std::vector<float> moved(static_cast<std::size_t>(region.u1 - region.u0));
    for (int v = region.v0; v < region.v1; ++v) {
      resample_row(image, map, region.u0, v, moved);
      for (int u = region.u0; u < region.u1; ++u) {
        const double n2 = contrast_.information(u, v), b = moved[static_cast<std::size_t>(u - region.u0)];
        ab += n2 * contrast_.bands[0](u, v) * b;
        bb += n2 * b * b;
      }
    }
    return bb > 0 ? ab / std::sqrt(bb) : 0;
  }

  /// body(tile, block, rows) for the part of every block that all images show, tile by tile on several threads.
  template <class Body>
  void for_blocks(const PixelRect& region, Body&& body) const {
    parallel_for(context_, blocks_.size(), 1, [&](std::size_t tile, std::size_t) {
      AlignedRows rows(contrast_.bands.size());
      for (const Block& block : blocks_[tile]) {
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

  Normals normal_equations(const std::vector<Affine>& maps, bool assess) const {
    const std::size_t count = maps.size();
    const PixelRect region = common_region(maps, size_, margin_);
    Normals total(count);
    if (region.empty()) return total;
    const double cauchy = disagreement_scale(maps, region) * options_.cauchy_scale * options_.cauchy_scale;
    std::vector<Normals> tiles(blocks_.size(), Normals(count));
    for_blocks(region, [&](std::size_t tile, const PixelRect& part, AlignedRows& rows) {
      add_block(maps, part, cauchy, assess, rows, tiles[tile]);
    });
    for (Normals& tile : tiles) {
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

  void add_block(const std::vector<Affine>& maps, const PixelRect& block, double cauchy, bool assess, AlignedRows& rows,
                 Normals& sum) const {
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
  static void add_row(const RowSums& row, double y, Normals& sum) {
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
                             Normals& sum) {
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

  double step(std::vector<Affine>& maps) const {
    const Normals normals = normal_equations(maps, false);
    const Eigen::LDLT<Matrix6> factor(normals.matrix);
    double largest = 0;
    if (factor.info() != Eigen::Success || !factor.isPositive()) return 0;
    for (std::size_t k = 1; k < maps.size(); ++k) {
      Vector6 p = factor.solve(normals.sides[k] - normals.sides[0]);
      if (!p.allFinite()) return 0;
      const double length = std::sqrt(mean_square_displacement(p * p.transpose(), size_));
      if (length > step_limit_px) p *= step_limit_px / length;
      maps[k] = displaced(maps[k], p, size_);
      largest = std::max(largest, length);
    }
    return largest;
  }

  const RegistrationOptions& options_;
  const Context& context_;
  Size size_;
  ContrastBands contrast_;
  std::vector<std::vector<Block>> blocks_;  ///< of each tile
  int margin_ = 0;
};

/// Half-size images, coarser and coarser; level 0 is half the input.
using Pyramid = std::vector<std::vector<Image<float>>>;

Pyramid coarser_levels(const std::vector<Image<float>>& images, const Context& context) {
  Pyramid pyramid;
  const std::vector<Image<float>>* finer = &images;
  while (std::min((*finer)[0].width(), (*finer)[0].height()) >= 2 * coarsest_side_px) {
    std::vector<Image<float>> halves(images.size());
    parallel_for(context, images.size(), 1, [&](std::size_t k, std::size_t) { halves[k] = half_size((*finer)[k]); });
    pyramid.push_back(std::move(halves));
    finer = &pyramid.back();
  }
  return pyramid;
}

}  // namespace

double affine_distance_px(const Affine& a, const Affine& b, Size size) {
  double sum = 0;
  for (const Eigen::Vector2d& corner : corners_and_center(size)) {
    sum += ((a - b).leftCols<2>() * corner + (a - b).col(2)).squaredNorm();
  }
  return std::sqrt(sum / 5);
}

void judge_registration(ImageRegistration& result, const RegistrationFigures& figures, Size size,
                        const RegistrationOptions& options) {
  std::ostringstream message;
  message.precision(3);
  const double linear = (result.image_from_base.leftCols<2>() - Eigen::Matrix2d::Identity()).norm();
  const bool has_texture = figures.texture >= least_texture, is_known = result.rms_px <= options.max_uncertainty_px;
  const auto shared = [](double texture) { return with_digits(100 * std::max(texture, 0.0), 3) + " %"; };
  if ((!has_texture || !is_known) && figures.unmoved_texture >= least_texture &&
      !(figures.texture >= least_kept_texture * figures.unmoved_texture)) {
    result.status = RegistrationStatus::strayed;
    message << "the search for the images' places went astray: where it moved them, " << shared(figures.texture)
            << " of their contrast is common to all, where they were " << shared(figures.unmoved_texture);
  } else if (!has_texture) {
    result.status = RegistrationStatus::no_texture;
    message << "too little texture: " << shared(figures.texture)
            << " of the contrast is common to all images, the rest is noise";
  } else if (!is_known) {
    result.status = RegistrationStatus::uncertain;
    // Not finite if the images show lines of one direction only, or texture in so small a part that nothing tells how
    // far they are turned.
    message << "its place cannot be told: its displacement is "
            << (std::isfinite(result.rms_px) ? "known to " + with_digits(result.rms_px, 3) + " px" : "not known")
            << ", expected " << with_digits(options.max_uncertainty_px, 3) << " px (capture.max_uncertainty_px)";
  } else if (!(result.displacement_px <= options.max_shift * size.width)) {
    result.status = RegistrationStatus::implausible;
    message << "displacement of " << with_digits(result.displacement_px, 3) << " px, more than "
            << 100 * options.max_shift << " % of the image width";
  } else if (!(linear <= options.max_shift)) {
    result.status = RegistrationStatus::implausible;
    message << "turned or distorted by " << with_digits(100 * linear, 3) << " %, more than " << 100 * options.max_shift
            << " %";
  } else if (!(figures.similarity >= least_similarity)) {
    result.status = RegistrationStatus::implausible;
    message << "the image does not resemble the others (similarity " << figures.similarity << ", 1 = alike)";
  } else if (!(figures.last_step_px <= 0.01)) {
    result.status = RegistrationStatus::not_converged;
    message << "its place was still changing, by " << figures.last_step_px << " px, when the search ended";
  } else {
    result.status = RegistrationStatus::ok;
  }
  result.message = message.str();
  if (result.status != RegistrationStatus::ok) result.image_from_base = identity_affine();
}

std::vector<ImageRegistration> register_images(const std::vector<Image<float>>& images, const NoiseModel& noise,
                                               const RegistrationOptions& options, const Context& context) {
  validate_fields(options, "capture");
  std::vector<ImageRegistration> results(images.size());
  if (images.empty()) return results;
  const Size size = images[0].size();
  for (std::size_t k = 0; k < images.size(); ++k) require_size(images[k], size, "image " + std::to_string(k));
  results[0].status = RegistrationStatus::ok;
  if (images.size() == 1) return results;
  if (std::min(size.width, size.height) < smallest_side_px) {
    for (std::size_t k = 1; k < images.size(); ++k) {
      results[k].status = RegistrationStatus::no_texture;
      results[k].message = "the image is " + to_string(size) + " pixels, too small to register";
    }
    return results;
  }

  const OpenCvThreads one_thread(1);  // OpenCV is called from threads of our own
  Pyramid pyramid = coarser_levels(images, context);
  std::vector<Affine> maps(images.size(), identity_affine());
  Level::Assessment assessment;
  double last_step_px = 0;
  for (std::size_t coarser = pyramid.size() + 1; coarser-- > 0;) {
    const bool coarsest = coarser == pyramid.size(), finest = coarser == 0;
    context.progress("capture", 1 - static_cast<double>(coarser + 1) / static_cast<double>(pyramid.size() + 1),
                     "registration");
    const bool has_quarters = coarser + 2 <= pyramid.size();
    // The finest level needs the most memory. It uses only the images and their quarters, so half-size images are
    // freed.
    if (finest && !coarsest) pyramid.front().clear();
    const Level level(finest ? images : pyramid[coarser - 1],
                      has_quarters ? pyramid[coarser + 1] : std::vector<Image<float>>{}, noise, options, context);
    for (std::size_t k = 1; coarsest && k < images.size(); ++k) maps[k] = level.phase_correlation(k);
    last_step_px = level.solve(maps, finest ? fine_tolerance_px : coarse_tolerance_px);
    if (finest) {
      assessment = level.assess(maps);
    } else {
      for (Affine& map : maps) map.col(2) *= 2;
    }
  }
  for (std::size_t k = 1; k < images.size(); ++k) {
    results[k].image_from_base = maps[k];
    results[k].displacement_px = affine_distance_px(maps[k], identity_affine(), size);
    results[k].rms_px = assessment.rms_px[k];
    judge_registration(results[k],
                       {assessment.texture, assessment.unmoved_texture, assessment.similarity[k], last_step_px}, size,
                       options);
  }
  return results;
}

}  // namespace malus
