#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/linalg/grid_system_internal.h"
#include "malus/linalg/symmetric_solver_internal.h"
#include "malus/prior/visible_points_internal.h"

namespace malus {

/// Absolute residuals of heights (GSD) and slopes (rad), measured across the surface: as if it were seen from the
/// front.
struct Residuals {
  std::vector<double> heights, slopes;
};

/// Robust standard deviations of heights and of slopes (along one axis).
struct ResidualSpread {
  double height = 0, slope = 0;
};

/// Robust thin-plate smoothing spline over the part of a mask inside a box: minimizes
///   Σ w facing (height − f)² + κ² Σ w' (slope − ∇f)ᵀ info (slope − ∇f) + λ² ∫ f_uu² + 2 f_uv² + f_vv² + |∇f|² /
///   tension²
/// over quadratic B-splines f on a lattice of square cells (a conforming discretization with natural boundary; only
/// cells that touch the mask take part). λ is in px if heights and noise have one unit; κ is the noise of a point over
/// that of a normal (see ViewPoint), in GSD / rad. w and w' are robust weights. The small tension makes f level out
/// farther than `tension_px` from all points; without it f would extrapolate the last slope.
class SmoothingSpline {
 public:
  SmoothingSpline(const Mask& mask, PixelRect box, double cell_px, double tension_px, std::span<const ViewPoint> points,
                  const Context& context);

  int unknowns() const { return nodes_.count(); }
  std::size_t points() const { return points_.size(); }
  /// Minimizes with the current weights.
  void solve(double lambda, double kappa);
  /// Sets the weights to 1 / (1 + (r / 2 spread)²)² of the current residuals r, with the spread of heights or of slopes
  /// (rad). Returns whether the weights changed: if their mean change is below `settled`, the old weights stay, and f
  /// still minimizes with them. With `keep_raised`, points nearer than f get full weight where many of their neighbors
  /// are nearer too: these are a part of the surface that stands out, not strays. Points behind f are not kept that
  /// way: a recess cannot be distinguished from a hidden surface seen through gaps in a sparse cloud. Slopes lose
  /// weight where f is softened at the edges of a raised part.
  bool reweight(const ResidualSpread& spread, double settled, bool keep_raised);
  /// Smooths less where f bends far more than is usual (steps, occluding edges): multiplies each cell's λ² by
  /// 1 / (1 + energy / (tolerance · typical)). `energy` is the bending energy of the current f in the cell, `typical`
  /// the geometric mean of that energy's mean and median over the cells.
  void soften_edges(double tolerance);
  /// Appends the residuals of all points (see Residuals).
  void append_residuals(Residuals& residuals) const;
  /// Sums of the weights of the points and of the slopes. A slope has two coordinates but counts once.
  double weight_sum() const;
  double slope_weight_sum() const;
  /// Weighted sum of squares of data and penalty at the minimum, where it equals Σ weight · datum · residual.
  double penalized_residual() const;
  /// ln det of the last normal matrix.
  double log_determinant() const { return solver_.log_determinant(); }

  /// f along one row of the raster, for columns [box.u0, box.u1); not a number outside active cells.
  void evaluate_row(int v, float* out) const;
  double evaluate(double u, double v) const;
  Eigen::Vector2d evaluate_slope(double u, double v) const;
  /// Posterior variance of f for unit noise variance, one value per cell (columns × rows, 0 where inactive). Estimated
  /// from `samples` random draws with the system of the last solve, and smoothed over neighboring cells.
  Image<float> variance(int samples, std::uint64_t seed);

  double cell_px() const { return cell_px_; }
  const PixelRect& box() const { return box_; }

 private:
  using Basis = Eigen::Matrix<double, 9, 1>;
  using SlopeBasis = Eigen::Matrix<double, 9, 2>;

  std::size_t cell_of(double u, double v) const;
  /// Position in the cell, 0 … 1 along each axis.
  Eigen::Vector2d place_in_cell(double u, double v) const;
  Basis basis(double u, double v) const;
  /// Derivatives of `basis` by u and v.
  SlopeBasis slope_basis(double u, double v) const;
  std::array<int, 9> cell_unknowns(std::size_t cell) const;
  Basis cell_coefficients(std::size_t cell) const;
  double value(std::size_t cell, const Basis& weights) const;
  Eigen::Vector2d slope_residual(const ViewPoint& p, std::size_t cell) const;
  /// For each cell, how likely points nearer than f belong to a raised part of the surface, 0 … 1: from the number of
  /// such points around the cell and from their share of all points there. `residuals`: of the points, over their
  /// spread, as if seen from the front.
  Image<float> raised_parts(std::span<const float> residuals) const;
  /// Raises the new weights of points on raised parts, and lowers the new weights of slopes at the edges of these
  /// parts.
  void keep_raised_parts(std::span<const float> residuals, std::span<float> weights, std::span<float> slope_weights);
  void set_tilt();
  /// Of the current weights, λ and κ.
  GridSystem normal_equations() const;
  /// Random right-hand side of covariance A (the normal matrix), made row by row of the problem: its solution is a draw
  /// with the posterior's covariance A⁻¹.
  void draw(const Eigen::Matrix<double, 9, 9>& stiffness_root, std::uint64_t seed,
            Eigen::Ref<Eigen::VectorXd> right) const;
  /// Calls body(cell) for every active cell, on all threads. Cells that are processed at the same time share no control
  /// point.
  template <class Body>
  void for_each_cell(Body&& body) const;

  Context context_;
  PixelRect box_;
  double cell_px_;
  int columns_, rows_;                     ///< of cells; there are two more control points in each direction
  std::vector<std::uint8_t> active_;       ///< per cell
  PixelIndex nodes_;                       ///< control points of the active cells: the unknowns
  LargeVector<ViewPoint> points_;          ///< sorted by cell
  std::vector<std::uint32_t> cell_start_;  ///< index in points_ of each cell's first point
  std::vector<float> weights_, slope_weights_;
  Eigen::Matrix<double, 9, 9> stiffness_;  ///< the same for every cell
  std::vector<float> tilt_;                ///< factor from a cell's bending in the image to the bending of the surface
  std::vector<float> softening_;           ///< factor of λ², per cell
  std::vector<float> raised_;              ///< largest value of raised_parts so far, per cell
  double lambda_ = 0, kappa_ = 0;
  Eigen::VectorXd coefficients_;
  SymmetricSolver solver_;
  bool analyzed_ = false;
};

}  // namespace malus
