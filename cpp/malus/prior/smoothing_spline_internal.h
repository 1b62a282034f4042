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
#include "malus/linalg/symmetric_solver_internal.h"
#include "malus/prior/visible_points_internal.h"

namespace malus {

/// Absolute residuals of heights (GSD) and slopes (rad), as if seen from the front.
struct Residuals {
  std::vector<double> heights, slopes;
};

/// Robust standard deviations of both, of a slope along one axis.
struct ResidualSpread {
  double height = 0, slope = 0;
};

/// Robust thin-plate smoothing spline over the part of a mask inside a box: minimizes
///   Σ w facing (height − f)² + κ² Σ w' (slope − ∇f)ᵀ info (slope − ∇f) + λ² ∫ f_uu² + 2 f_uv² + f_vv² + |∇f|² /
///   tension²
/// over quadratic B-splines f on a lattice of square cells (a conforming discretization with natural boundary; only
/// cells that touch the mask take part). λ is in px for heights and noise in one unit; κ is the noise of a point over
/// that of a normal (see ViewPoint), in GSD / rad. w and w' are robust weights. The small tension makes f level out
/// farther than `tension_px` from all points instead of running away along the last slope.
class SmoothingSpline {
 public:
  SmoothingSpline(const Mask& mask, PixelRect box, double cell_px, double tension_px, std::span<const ViewPoint> points,
                  const Context& context);

  std::size_t unknowns() const { return unknowns_; }
  std::size_t points() const { return points_.size(); }
  /// Minimizes with the present weights.
  void solve(double lambda, double kappa);
  /// Weights 1 / (1 + (r / 2 spread)²)² of the present residuals, of heights by their spread and of slopes by theirs
  /// (rad). Returns whether they are new: if they would change by less than `settled` in the mean, they stay, and the
  /// minimum is still theirs. With `keep_raised` points nearer than f count in full where many of their neighbors
  /// are nearer too: a part of the surface that stands out, not strays. What lies behind f does not: nothing tells a
  /// recess from a surface that is hidden and seen between too few points. Slopes lose weight where f gives way at the
  /// edges of such a part.
  bool reweight(const ResidualSpread& spread, double settled = 0, bool keep_raised = false);
  /// Lets cells give way in which f bends far more than is usual (steps, occluding edges): their λ² is multiplied by
  /// 1 / (1 + energy / (tolerance · typical)), with the energy of the present f and `typical` the geometric mean of its
  /// mean and median over the cells.
  void soften_edges(double tolerance);
  /// Appends the residual of every point, as if seen from the front.
  void append_residuals(Residuals& residuals) const;
  /// Sum of the weights of the points and of their slopes, of which each has two coordinates.
  double weight_sum() const;
  double slope_weight_sum() const;
  /// Sum of squares of data and penalty at the minimum, where it is Σ of weight · datum · residual.
  double penalized_residual() const;
  /// ln det of the last normal matrix.
  double log_determinant() const { return solver_.log_determinant(); }

  /// f along one row of the raster, for columns [box.u0, box.u1); not a number outside active cells.
  void evaluate_row(int v, float* out) const;
  double evaluate(double u, double v) const;
  Eigen::Vector2d evaluate_slope(double u, double v) const;
  /// Variance of f for unit noise variance, one value a cell (columns × rows, 0 where inactive): the posterior of the
  /// last solve by `samples` draws, smoothed over neighboring cells.
  Image<float> variance(int samples, std::uint64_t seed);

  double cell_px() const { return cell_px_; }
  const PixelRect& box() const { return box_; }

 private:
  using Basis = std::array<double, 9>;

  std::size_t cell_of(double u, double v) const;
  Basis basis(double u, double v) const;
  /// Derivatives of `basis` by u and v.
  std::array<Basis, 2> slope_basis(double u, double v) const;
  double value(std::size_t cell, const Basis& weights) const;
  Eigen::Vector2d slope_residual(const ViewPoint& p, std::size_t cell) const;
  std::array<std::int32_t, 9> cell_unknowns(std::size_t cell) const;
  /// How surely points nearer than f are a part of the surface, a cell, 0 … 1: by how many there are around and by
  /// their share of all. Residuals of the points over their spread, as if seen from the front.
  Image<float> raised_parts(std::span<const float> residuals) const;
  /// Raises the new weights of points on such parts, and lowers those of slopes at their edges.
  void keep_raised_parts(std::span<const float> residuals, std::span<float> weights, std::span<float> slope_weights);
  void set_tilt();
  void build_pattern();
  std::vector<int> elimination_order() const;
  void assemble(double lambda, double kappa);
  Eigen::VectorXd right_side() const;
  /// Noise of unit variance times the square root of the normal matrix, row by row of the problem: its solution is a
  /// draw with the posterior's covariance A⁻¹.
  void draw(const Eigen::Matrix<double, 9, 9>& stiffness_root, std::uint64_t seed,
            Eigen::Ref<Eigen::VectorXd> right) const;
  /// Calls body(cell) for every active cell, on all threads; two cells at a time have no control point in common.
  template <class Body>
  void for_each_cell(Body&& body) const;

  Context context_;
  PixelRect box_;
  double cell_px_;
  int columns_, rows_;                 ///< of cells; control points are two more each way
  std::vector<std::uint8_t> active_;   ///< a cell
  std::vector<std::int32_t> unknown_;  ///< a control point; -1 = none
  std::size_t unknowns_ = 0;
  LargeVector<ViewPoint> points_;          ///< sorted by cell
  std::vector<std::uint32_t> cell_start_;  ///< of points_, a cell
  std::vector<float> weights_, slope_weights_;
  Eigen::Matrix<double, 9, 9> stiffness_;  ///< of any cell
  std::vector<float> tilt_;                ///< factor that turns a cell's bending into that of the surface
  std::vector<float> softening_;           ///< factor of λ², a cell
  std::vector<float> raised_;              ///< the most that raised_parts has said, a cell
  std::vector<std::int32_t> slots_;        ///< 13 a column: where the lower neighbors' entries are
  double lambda_ = 0, kappa_ = 0;
  Eigen::VectorXd coefficients_;
  SymmetricSolver::Matrix matrix_;  ///< lower triangle
  SymmetricSolver solver_;
  bool analyzed_ = false;
};

}  // namespace malus
