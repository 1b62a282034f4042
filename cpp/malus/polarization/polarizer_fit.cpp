#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>

#include "malus/core/degrees_internal.h"
#include "malus/core/dense_systems_internal.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/tiled_axis_internal.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/polarizer_fit_internal.h"

namespace malus {
namespace {

constexpr int image_parts_per_side = 8;
constexpr int robust_passes = 2;
/// Number of cells that an object is divided into, unless cells would exceed the largest size.
constexpr double wanted_cells = 5000;
constexpr int largest_cell_px = 16;
/// Cells of small objects have this size, although they become fewer: the mean of fewer pixels still shows which images
/// registration has smoothed, and a fit of angles takes the noise of the others for polarization.
constexpr int least_cell_px = 4;
/// With fewer cells, as on a wire or under a mask with many small holes, smaller cells are tried.
constexpr std::size_t fewest_cells = 500;
/// Ratio to the typical residual at which a pixel has half its weight.
constexpr double cauchy_scale = 3;
/// Standard deviation that stands for "unknown" where a matrix must be invertible [rad].
constexpr double unknown_sigma_rad = 30;

/// Weighted second moments of the intensities, one K × K matrix for each part of the image.
struct Moments {
  std::vector<Eigen::MatrixXd> parts;
  double pixels = 0;
  double weights = 0;  ///< sum of the robust weights, 1 for a pixel that follows the model

  Eigen::MatrixXd total() const {
    Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(parts[0].rows(), parts[0].cols());
    for (const Eigen::MatrixXd& part : parts) sum += part;
    return sum;
  }
};

/// Weight of a pixel: inverse noise variance times a Cauchy factor. The factor depends on the squared residual per
/// degree of freedom, the part of the pixel's intensities outside the space of the rows.
struct PixelWeight {
  Eigen::MatrixXd complement;  ///< (K − 3) × K orthonormal rows; empty = weights from noise alone
  double scale2 = 1;           ///< typical squared residual

  double squared_residual(const Eigen::VectorXd& values, double variance) const {
    return (complement * values).squaredNorm() / static_cast<double>(complement.rows()) / variance;
  }
  double operator()(const Eigen::VectorXd& values, double variance) const {
    if (complement.rows() == 0) return 1 / variance;
    return 1 / variance / (1 + squared_residual(values, variance) / (cauchy_scale * cauchy_scale * scale2));
  }
};

/// Mean intensities of the images in square cells, which follow the same model with less noise. On weakly polarizing
/// objects, noise that differs between images (the base image is not resampled) and texture left by registration would
/// otherwise pass for polarization. Only cells whose pixels are all usable are kept.
class Cells {
 public:
  struct Cell {
    int column, row;
    double variance;  ///< noise variance of the means
  };
  /// The cells of one part of the image, row by row.
  struct Part {
    std::vector<Cell> cells;
    std::vector<double> means;  ///< of every image, cell by cell
  };

  Cells(std::span<const Image<float>> images, const NoiseModel& noise, const Mask& mask, const Mask& saturated,
        const Context& context)
      : count_(static_cast<Eigen::Index>(images.size())), parts_(image_parts_per_side * image_parts_per_side) {
    const auto object = static_cast<double>(count_of_set(mask));
    side_ = std::clamp(static_cast<int>(std::sqrt(object / wanted_cells)), least_cell_px, largest_cell_px);
    while (fill(images, noise, mask, saturated, context) < fewest_cells && side_ > 1) side_ /= 2;
  }

  const std::vector<Part>& parts() const { return parts_; }
  Eigen::Map<const Eigen::VectorXd> means(const Part& part, std::size_t cell) const {
    return {part.means.data() + static_cast<Eigen::Index>(cell) * count_, count_};
  }
  /// Size of the image in cells.
  Size size() const { return size_; }
  double pixels_in_cell() const { return side_ * side_; }
  /// Number of images.
  Eigen::Index count() const { return count_; }

 private:
  /// Replaces the cells by those of the present size; returns their number.
  std::size_t fill(std::span<const Image<float>> images, const NoiseModel& noise, const Mask& mask,
                   const Mask& saturated, const Context& context) {
    size_ = {images[0].width() / side_, images[0].height() / side_};
    const TiledImage tiles({0, 0, size_.width, size_.height}, image_parts_per_side, image_parts_per_side, 0);
    parallel_for(context, parts_.size(), 1, [&](std::size_t part, std::size_t) {
      parts_[part] = {};
      for_each_pixel(tiles.box(static_cast<int>(part)), [&](int u, int v) {
        if (is_usable(u, v, mask, saturated)) read(u, v, images, noise, parts_[part]);
      });
    });
    std::size_t count = 0;
    for (const Part& part : parts_) count += part.cells.size();
    return count;
  }

  bool is_usable(int column, int row, const Mask& mask, const Mask& saturated) const {
    for (int v = row * side_; v < (row + 1) * side_; ++v) {
      for (int u = column * side_; u < (column + 1) * side_; ++u) {
        if (mask(u, v) == 0 || (!saturated.empty() && saturated(u, v) != 0)) return false;
      }
    }
    return true;
  }

  void read(int column, int row, std::span<const Image<float>> images, const NoiseModel& noise, Part& part) const {
    const double pixels = pixels_in_cell();
    Eigen::VectorXd means(count_);
    for (std::size_t k = 0; k < images.size(); ++k) {
      double sum = 0;
      for (int v = row * side_; v < (row + 1) * side_; ++v) {
        const float* const first = images[k].row(v) + column * side_;
        for (int u = 0; u < side_; ++u) sum += first[u];
      }
      means[static_cast<Eigen::Index>(k)] = sum / pixels;
    }
    const double mean = means.mean();
    if (!std::isfinite(mean) || !(mean > 5 * std::sqrt(noise.variance(0)))) return;
    part.cells.push_back({column, row, noise.variance(mean) / pixels});
    part.means.insert(part.means.end(), means.begin(), means.end());
  }

  Eigen::Index count_;
  std::vector<Part> parts_;
  int side_ = 1;
  Size size_;
};

Moments second_moments(const Cells& cells, const PixelWeight& weight, const Context& context) {
  const Eigen::Index count = cells.count();
  const std::size_t parts = cells.parts().size();
  Moments moments;
  moments.parts.assign(parts, Eigen::MatrixXd::Zero(count, count));
  std::vector<double> weights(parts, 0.0);
  parallel_for(context, parts, 1, [&](std::size_t i, std::size_t) {
    const Cells::Part& part = cells.parts()[i];
    for (std::size_t cell = 0; cell < part.cells.size(); ++cell) {
      const Eigen::VectorXd means = cells.means(part, cell);
      const double use = weight(means, part.cells[cell].variance);
      moments.parts[i].selfadjointView<Eigen::Lower>().rankUpdate(means, use);
      weights[i] += use * part.cells[cell].variance;
    }
    moments.parts[i] = moments.parts[i].selfadjointView<Eigen::Lower>();
  });
  for (const Cells::Part& part : cells.parts()) {
    moments.pixels += cells.pixels_in_cell() * static_cast<double>(part.cells.size());
  }
  for (const double sum : weights) moments.weights += sum;
  return moments;
}

/// Median squared residual per degree of freedom over a regular sample of cells.
double typical_residual(const Cells& cells, const PixelWeight& weight) {
  constexpr double samples = 40000;
  const int stride = std::max(1, static_cast<int>(std::sqrt(static_cast<double>(cells.size().area()) / samples)));
  std::vector<double> residuals;
  for (const Cells::Part& part : cells.parts()) {
    for (std::size_t i = 0; i < part.cells.size(); ++i) {
      const Cells::Cell& cell = part.cells[i];
      if (cell.column % stride != 0 || cell.row % stride != 0) continue;
      residuals.push_back(weight.squared_residual(cells.means(part, i), cell.variance));
    }
  }
  if (residuals.empty()) return 1;
  return std::max(median_in_place(residuals), 1e-12);
}

/// Unknowns of the fit: angles, then ln gains.
struct Polarizer {
  Eigen::VectorXd values;

  Eigen::Index count() const { return values.size() / 2; }
  std::vector<double> angles_rad() const { return {values.data(), values.data() + count()}; }
  std::vector<double> gains() const {
    std::vector<double> result;
    for (Eigen::Index k = 0; k < count(); ++k) result.push_back(std::exp(values[count() + k]));
    return result;
  }
  Eigen::MatrixX3d rows() const { return polarizer_rows(angles_rad(), gains()); }
  /// Derivative of row `parameter % K` by that parameter; the other rows do not change.
  Eigen::Vector3d row_slope(Eigen::Index parameter) const {
    const Eigen::Index k = parameter % count();
    const double half = 0.5 * std::exp(values[count() + k]), twice = 2 * values[k];
    if (parameter < count()) return {0, -2 * half * std::sin(twice), 2 * half * std::cos(twice)};
    return {half, half * std::cos(twice), half * std::sin(twice)};
  }
};

/// The projected problem at one point: computes the sum of squares, its gradient and its curvature from moments.
class Projection {
 public:
  explicit Projection(const Polarizer& polarizer) : polarizer_(polarizer) {
    const Eigen::MatrixX3d rows = polarizer.rows();
    stokes_from_values_ = stokes_of_intensities(rows);
    outside_ = Eigen::MatrixXd::Identity(rows.rows(), rows.rows()) - rows * stokes_from_values_;
  }

  double cost(const Eigen::MatrixXd& moments) const { return outside_.cwiseProduct(moments).sum(); }

  Eigen::VectorXd gradient(const Eigen::MatrixXd& moments) const {
    const Eigen::MatrixXd residual_by_stokes = outside_ * moments * stokes_from_values_.transpose();
    Eigen::VectorXd result(polarizer_.values.size());
    for (Eigen::Index i = 0; i < result.size(); ++i) {
      result[i] = -2 * residual_by_stokes.row(i % polarizer_.count()).dot(polarizer_.row_slope(i));
    }
    return result;
  }

  /// Gauss–Newton with Kaufman's derivative of the projected residual, −P⊥ dA A⁺.
  Eigen::MatrixXd curvature(const Eigen::MatrixXd& moments) const {
    const Eigen::Matrix3d stokes_moments = stokes_from_values_ * moments * stokes_from_values_.transpose();
    const Eigen::Index size = polarizer_.values.size(), count = polarizer_.count();
    Eigen::MatrixXd result(size, size);
    for (Eigen::Index i = 0; i < size; ++i) {
      const Eigen::Vector3d slope = stokes_moments * polarizer_.row_slope(i);
      for (Eigen::Index j = 0; j < size; ++j) {
        result(i, j) = 2 * outside_(i % count, j % count) * slope.dot(polarizer_.row_slope(j));
      }
    }
    return result;
  }

  /// Orthonormal rows, (K − 3) × K, that span the intensities that no Stokes vector can produce.
  Eigen::MatrixXd complement() const {
    return symmetric_eigen(outside_).vectors.rightCols(outside_.rows() - 3).transpose();
  }

 private:
  const Polarizer& polarizer_;
  Eigen::MatrixXd stokes_from_values_;  ///< 3 × K
  Eigen::MatrixXd outside_;             ///< K × K projection
};

/// Nominal values and their weights.
struct Nominal {
  Eigen::VectorXd values, weight;  ///< weight = 1 / variance

  double cost(const Polarizer& p) const { return (p.values - values).cwiseAbs2().dot(weight); }
};

Nominal nominal_values(std::span<const double> nominal_rad, Eigen::Index count, const PolarizerOptions& options) {
  const double sigma_rad = to_radians(options.angle_sigma_deg);
  Nominal nominal{Eigen::VectorXd::Zero(2 * count), Eigen::VectorXd::Zero(2 * count)};
  nominal.weight.tail(count).setConstant(1 / (options.gain_sigma * options.gain_sigma));
  for (std::size_t k = 0; k < nominal_rad.size(); ++k) {
    nominal.values[static_cast<Eigen::Index>(k)] = nominal_rad[k];
    nominal.weight[static_cast<Eigen::Index>(k)] = 1 / (sigma_rad * sigma_rad);
  }
  return nominal;
}

/// Levenberg–Marquardt on (projected sum of squares) / inflation + nominal terms. Returns the cost at the end.
double minimize(Polarizer& polarizer, const Eigen::MatrixXd& moments, double inflation, const Nominal& nominal) {
  const auto total = [&](const Polarizer& p) { return Projection(p).cost(moments) / inflation + nominal.cost(p); };
  double cost = total(polarizer), damping = 1e-3;
  for (int iteration = 0; iteration < 500; ++iteration) {
    const Projection projection(polarizer);
    Eigen::MatrixXd normal = projection.curvature(moments) / inflation;
    normal.diagonal() += 2 * nominal.weight;
    const Eigen::VectorXd right =
        -projection.gradient(moments) / inflation - 2 * nominal.weight.cwiseProduct(polarizer.values - nominal.values);
    bool accepted = false;
    double gained = 0;
    while (!accepted && damping < 1e12) {
      Eigen::MatrixXd damped = normal;
      damped.diagonal() += damping * normal.diagonal() + Eigen::VectorXd::Constant(normal.rows(), 1e-9);
      Polarizer next{polarizer.values + solve_symmetric(damped, right)};
      const double next_cost = next.values.allFinite() ? total(next) : std::numeric_limits<double>::infinity();
      accepted = next_cost < cost;
      if (accepted) {
        gained = cost - next_cost;
        polarizer = std::move(next);
        cost = next_cost;
        damping = std::max(damping / 10, 1e-12);
      } else {
        damping *= 10;
      }
    }
    if (!accepted || gained < 1e-10 * cost) break;
  }
  return cost;
}

/// Angles and gains whose rows span the same space as `space` (K × 3, orthonormal): M = T diag(1, −1, −1) Tᵀ with u_kᵀ
/// M u_k = 0 for every row u_k, as all rows lie on the cone. Nothing if M has another signature, because of noise.
std::vector<Polarizer> start_from_space(const Eigen::MatrixX3d& space) {
  Eigen::MatrixXd conditions(space.rows(), 6);
  for (Eigen::Index k = 0; k < space.rows(); ++k) {
    const Eigen::RowVector3d u = space.row(k);
    conditions.row(k) << u[0] * u[0], u[1] * u[1], u[2] * u[2], 2 * u[0] * u[1], 2 * u[0] * u[2], 2 * u[1] * u[2];
  }
  const Eigen::VectorXd m = symmetric_eigen(conditions.transpose() * conditions).vectors.col(0);
  Eigen::Matrix3d cone;
  cone << m[0], m[3], m[4], m[3], m[1], m[5], m[4], m[5], m[2];
  if (cone.determinant() < 0) cone = -cone;  // One positive and two negative eigenvalues: a positive determinant.
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(cone);
  const Eigen::Vector3d& values = solver.eigenvalues();
  if (!(values[1] < 0 && values[2] > 0)) return {};
  Eigen::Matrix3d rows_from_space;
  rows_from_space << solver.eigenvectors().col(2) * std::sqrt(values[2]),
      solver.eigenvectors().col(0) * std::sqrt(-values[0]), solver.eigenvectors().col(1) * std::sqrt(-values[1]);
  Eigen::MatrixX3d rows = space * rows_from_space;
  if (rows.col(0).mean() < 0) rows = -rows;
  if (!(rows.col(0).array() > 0).all()) return {};
  return {Polarizer{angles_and_gains(rows)}};
}

/// Starting points of the search: the nominal angles. Without these: the angles that the images' space allows, and
/// evenly spread angles in several orders.
std::vector<Polarizer> starts(const Nominal& nominal, bool free_angles, const Eigen::MatrixXd& moments) {
  if (!free_angles) return {{nominal.values}};
  const Eigen::Index count = moments.rows();
  std::vector<Polarizer> result = start_from_space(symmetric_eigen(moments).vectors.rightCols(3));
  for (Eigen::Index turns = 1; 2 * turns < count; ++turns) {
    Polarizer even{Eigen::VectorXd::Zero(2 * count)};
    for (Eigen::Index k = 0; k < count; ++k) {
      even.values[k] = std::numbers::pi * static_cast<double>(turns * k) / static_cast<double>(count);
    }
    result.push_back(std::move(even));
  }
  return result;
}

Polarizer search(const Nominal& nominal, bool free_angles, const Eigen::MatrixXd& moments) {
  Polarizer best;
  double lowest = std::numeric_limits<double>::infinity();
  for (Polarizer& candidate : starts(nominal, free_angles, moments)) {
    const double cost = minimize(candidate, moments, 1, nominal);
    if (cost < lowest) {
      lowest = cost;
      best = std::move(candidate);
    }
  }
  if (best.values.size() == 0) {  // every cost overflows
    throw data_error(
        "the polarizer angles cannot be calibrated: the images' noise, which full_well_e, read_noise_e and "
        "frames_averaged state, is too small to compute with");
  }
  return best;
}

/// Pseudo-inverse of a symmetric matrix, without directions whose eigenvalues are at the rounding level of the largest
/// one.
Eigen::MatrixXd symmetric_pseudo_inverse(const Eigen::MatrixXd& matrix) {
  const auto [values, vectors] = symmetric_eigen(matrix);
  const double floor = 1e-9 * values.maxCoeff();
  const Eigen::VectorXd inverse = values.unaryExpr([floor](double x) { return x > floor ? 1 / x : 0.0; });
  return vectors * inverse.asDiagonal() * vectors.transpose();
}

/// How much larger the scatter of the parts' gradients is than noise alone would make it: the factor between the
/// sum of squares and twice a log-likelihood.
double inflation_of(const Moments& moments, const Polarizer& polarizer) {
  const Projection projection(polarizer);
  const Eigen::MatrixXd curvature = projection.curvature(moments.total());
  Eigen::MatrixXd scatter = Eigen::MatrixXd::Zero(curvature.rows(), curvature.cols());
  for (const Eigen::MatrixXd& part : moments.parts) {
    const Eigen::VectorXd gradient = projection.gradient(part);
    scatter += gradient * gradient.transpose();
  }
  const Eigen::MatrixXd inverse = symmetric_pseudo_inverse(curvature);
  const double rank = (inverse * curvature).trace();
  return rank < 0.5 ? 1 : std::max((inverse * scatter).trace() / rank / 2, 1.0);
}

void check(std::span<const Image<float>> images, std::span<const double> nominal_rad, const Mask& mask,
           const Mask& saturated, const PolarizerOptions& options) {
  validate_fields(options, "polarizer");
  if (!nominal_rad.empty() && nominal_rad.size() != images.size()) {
    throw input_error(std::to_string(images.size()) + " polarized images but " + std::to_string(nominal_rad.size()) +
                      " polarizer angles, expected one angle per image");
  }
  for (std::size_t k = 0; k < nominal_rad.size(); ++k) {
    if (!std::isfinite(nominal_rad[k])) {
      throw input_error("angle of polarized image " + std::to_string(k) + " is not a finite number");
    }
  }
  const std::size_t needed = nominal_rad.empty() ? min_images_for_free_angles : 3;
  if (images.size() < needed) {
    throw data_error(std::to_string(images.size()) + " polarized images, expected at least " + std::to_string(needed) +
                     (nominal_rad.empty() ? " to find angles that are not known at all (angles_deg = \"auto\")" : ""));
  }
  for (const Image<float>& image : images) require_size(image, images[0].size(), "polarized image");
  require_size(mask, images[0].size(), "mask");
  if (!saturated.empty()) require_size(saturated, images[0].size(), "saturation mask");
}

}  // namespace

Eigen::MatrixX3d polarizer_rows(std::span<const double> angles_rad, std::span<const double> gains) {
  Eigen::MatrixX3d rows(static_cast<Eigen::Index>(angles_rad.size()), 3);
  for (std::size_t k = 0; k < angles_rad.size(); ++k) {
    const double gain = gains.empty() ? 1 : gains[k];
    rows.row(static_cast<Eigen::Index>(k)) = gain * polarizer_row(angles_rad[k]).transpose();
  }
  return rows;
}

Eigen::VectorXd angles_and_gains(const Eigen::MatrixX3d& rows) {
  const Eigen::Index count = rows.rows();
  Eigen::VectorXd values(2 * count);
  for (Eigen::Index k = 0; k < count; ++k) values[k] = 0.5 * std::atan2(rows(k, 2), rows(k, 1));
  values.tail(count) = rows.col(0).array().log().matrix();
  values.tail(count).array() -= values.tail(count).mean();
  return values;
}

Eigen::Matrix3Xd stokes_of_intensities(const Eigen::MatrixX3d& rows) {
  return symmetric_pseudo_inverse(rows.transpose() * rows) * rows.transpose();
}

Eigen::MatrixXd residual_projection(const Eigen::MatrixX3d& rows) {
  return Eigen::MatrixXd::Identity(rows.rows(), rows.rows()) - rows * stokes_of_intensities(rows);
}

bool PolarizerFit::is_plausible(const PolarizerOptions& options) const {
  constexpr double deviations = 5;
  return largest_angle_change_rad < to_radians(deviations * options.angle_sigma_deg) &&
         largest_gain_change < deviations * options.gain_sigma;
}

PolarizerFit polarizer_as_given(std::span<const double> angles_rad, const PolarizerOptions& options) {
  const Nominal nominal = nominal_values(angles_rad, static_cast<Eigen::Index>(angles_rad.size()), options);
  PolarizerFit fit;
  fit.angles_rad.assign(angles_rad.begin(), angles_rad.end());
  fit.gains.assign(angles_rad.size(), 1.0);
  fit.nominal_weight = nominal.weight;
  fit.image_information = Eigen::MatrixXd::Zero(nominal.weight.size(), nominal.weight.size());
  return fit;
}

PolarizerFit fit_polarizer(std::span<const Image<float>> images, std::span<const double> nominal_rad,
                           const NoiseModel& noise, const Mask& mask, const Mask& saturated,
                           const PolarizerOptions& options, const Context& context) {
  check(images, nominal_rad, mask, saturated, options);
  const bool free_angles = nominal_rad.empty();
  const auto count = static_cast<Eigen::Index>(images.size());
  const Cells cells(images, noise, mask, saturated, context);
  const Nominal nominal = nominal_values(nominal_rad, count, options);

  PixelWeight weight;
  Moments moments = second_moments(cells, weight, context);
  if (moments.pixels < 100) {
    throw data_error(
        "fewer than 100 pixels of the object are neither saturated nor dark in the polarized images: "
        "their polarizer angles cannot be calibrated");
  }
  Polarizer polarizer = search(nominal, free_angles, moments.total());
  double inflation = 1;
  for (int pass = 0; pass < robust_passes && count > 3; ++pass) {
    context.progress("polarization", 0, "polarizer angles");
    weight.complement = Projection(polarizer).complement();
    weight.scale2 = typical_residual(cells, weight);
    moments = second_moments(cells, weight, context);
    inflation = inflation_of(moments, polarizer);
    minimize(polarizer, moments.total(), inflation, nominal);
  }

  PolarizerFit fit;
  fit.angles_rad = polarizer.angles_rad();
  fit.gains = polarizer.gains();
  fit.nominal_weight = nominal.weight.cwiseMax(1 / (unknown_sigma_rad * unknown_sigma_rad));
  fit.pixels = moments.pixels;
  const Eigen::MatrixXd total = moments.total();
  fit.image_information = Projection(polarizer).curvature(total) / (2 * inflation);
  for (std::size_t k = 0; k < nominal_rad.size(); ++k) {
    fit.largest_angle_change_rad = std::max(fit.largest_angle_change_rad, std::abs(fit.angles_rad[k] - nominal_rad[k]));
    fit.largest_gain_change = std::max(fit.largest_gain_change, std::abs(std::log(fit.gains[k])));
  }
  if (count > 3) {
    const double freedom = moments.weights * static_cast<double>(count - 3);
    fit.residual_after = std::sqrt(std::max(Projection(polarizer).cost(total), 0.0) / freedom);
    fit.residual_before = fit.residual_after;
    if (!free_angles) {
      const Polarizer given{nominal.values};
      fit.residual_before = std::sqrt(std::max(Projection(given).cost(total), 0.0) / freedom);
    }
  }
  return fit;
}

}  // namespace malus
