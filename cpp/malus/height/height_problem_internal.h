#pragma once

#include <Eigen/Core>
#include <vector>

#include "malus/core/context.h"
#include "malus/height/height_data_internal.h"
#include "malus/linalg/grid_solver_internal.h"
#include "malus/linalg/grid_system_internal.h"
#include "malus/polarization/slopes_of_depth_internal.h"

namespace malus {

/// i_un = light[0..2] · n + light[3], and the standard deviation of this shading model.
struct HeightLight {
  Eigen::Vector4d coefficients = Eigen::Vector4d::Zero();
  double shading_sigma = 0;
};

/// The height's least-squares problem, with one unknown per pixel of the object.
class HeightProblem {
 public:
  /// Data and options must outlive this.
  HeightProblem(const HeightData& data, const HeightOptions& options, const HeightLight& light, const Context& context);

  int unknowns() const { return pixels_.count(); }
  const PixelIndex& pixels() const { return pixels_; }
  double solver_bytes() const { return solver_.factor_bytes(); }

  /// Sets `height` to the prior's heights, continued by the linear system where the prior has none. False if the prior
  /// has no height at all or cannot be continued.
  bool start_from_prior(Eigen::VectorXd& height);

  /// Solves the linear system of Eq 9 and 11. If the data have a `ring_height`, `height` must contain a start.
  SolveStatus solve_linear(bool literal, Eigen::VectorXd& height);
  /// Linearizes the likelihood at a height; returns its robust cost per pixel.
  double linearize(const Eigen::VectorXd& height);
  /// Minimizes the likelihood linearized at `height` and sets `height` to the minimum.
  SolveStatus solve_linearized(Eigen::VectorXd& height);

  /// RMS of the derivatives of a height.
  double slope_rms(const Eigen::VectorXd& height) const;
  /// RMS of the residuals at a height over all pixels: of the likelihood or of the linear rows, by the method.
  double residual_rms(const Eigen::VectorXd& height) const;

 private:
  /// A derivative at a pixel as a weighted sum of up to three unknowns.
  struct Difference {
    int unknowns[3];
    double coefficients[3];
    int count = 0;

    double operator()(const Eigen::VectorXd& x) const {
      double sum = 0;
      for (int i = 0; i < count; ++i) sum += coefficients[i] * x[unknowns[i]];
      return sum;
    }
  };

  /// Least-squares rows of one pixel, summed: ½ gᵀ A g − gᵀ b with the derivatives g = (h_u, h_v) of the height.
  struct Term {
    double uu = 0, uv = 0, vv = 0, right_u = 0, right_v = 0;

    /// Adds weight · (p · P + q · Q − target)² for slopes affine in the derivatives.
    void add_row(const AffineSlopes& slopes, double p, double q, double target, double weight);
  };

  /// Precomputed for a pixel's ray: the slopes as affine functions of the height's derivatives, and the light along
  /// right, up and view.
  struct Frame {
    float constant_p, constant_q, p_per_u, q_per_u, p_per_v, q_per_v;
    float light_right, light_up, light_view;

    AffineSlopes slopes() const { return {{constant_p, constant_q}, {p_per_u, q_per_u}, {p_per_v, q_per_v}}; }
  };

  struct LinearRows {
    double phase_p, phase_q, phase_weight;
    double shading_p, shading_q, shading_target;
  };

  /// Residuals of a pixel divided by their standard deviations, and their derivatives by P and Q.
  struct Residuals {
    Eigen::Vector3d value, by_p, by_q;

    double shading_square() const { return value[0] * value[0]; }
    double stokes_square() const { return value[1] * value[1] + value[2] * value[2]; }
  };

  template <class Body>
  void for_each_pixel(Body&& body);
  /// Mean of value(i) over the unknowns.
  template <class Value>
  double mean_of(Value&& value) const;
  Difference difference(int u, int v, int du, int dv) const;
  const HeightPixel& pixel(int i) const { return data_.pixels(pixels_.u(i), pixels_.v(i)); }
  const Frame& frame(int i) const { return frames_[static_cast<std::size_t>(i)]; }
  Frame frame_at(int u, int v) const;
  /// Derivatives of a height along u and v.
  Eigen::Vector2d gradient(int i, const Eigen::VectorXd& height) const;
  Slopes slopes_of(int i, const Eigen::VectorXd& height) const;
  LinearRows linear_rows(int i, bool literal) const;
  Term linear_term(int i, bool literal) const;
  double stokes_gain(const HeightPixel& data, double tan2) const;
  Residuals residuals(int i, const Slopes& s) const;
  double square_limit() const { return options_.outlier_scale * options_.outlier_scale; }
  /// Cauchy weight of a squared residual.
  double robust_weight(double square) const { return 1 / (1 + square / square_limit()); }
  /// Sum of a pixel's squared residuals at a height: of the likelihood and of the linear rows.
  double likelihood_square(int i, const Eigen::VectorXd& height) const;
  double linear_square(int i, const Eigen::VectorXd& height) const;
  double likelihood_term(int i, const Eigen::VectorXd& height, Term& term) const;
  /// Rows of the terms, smoothness and held heights; with `holds_prior` the prior's heights are held, too.
  void assemble(bool holds_prior);
  SolveStatus solve_assembled(Eigen::VectorXd& height, bool holds_prior = false);
  void add_term(const Term& term, const Difference& by_u, const Difference& by_v);
  void add_smoothness(int here, int before, int after);
  void add_held(int i, float target, double weight);

  const HeightData& data_;
  const HeightOptions& options_;
  const HeightLight light_;
  const Pinhole* camera_;
  const Pinhole* rays_;  ///< the camera; null = orthographic
  const Context& context_;
  PixelIndex pixels_;
  GridSystem system_;
  GridSolver solver_;
  std::vector<Frame> frames_;
  std::vector<Term> terms_;
};

}  // namespace malus
