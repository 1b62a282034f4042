#pragma once

#include <Eigen/Core>
#include <utility>

#include "malus/core/context.h"
#include "malus/linalg/symmetric_solver_internal.h"

namespace malus {

/// How conjugate gradients ended.
struct ConjugateGradients {
  SolveStatus status = SolveStatus::solved;
  int iterations = 0;
  double residual = 0;  ///< |A x − b|
};

/// Solves A x = b for a symmetric positive definite A by preconditioned conjugate gradients. `residual` is b − A x for
/// the x to start from. Ends once its norm is at most `enough`, or as `inaccurate` after `most_iterations`.
/// product(direction, out) sets out to A · direction, precondition(residual, out) to an approximation of A⁻¹ ·
/// residual. An own loop, because Eigen's cannot be interrupted.
template <class Product, class Precondition>
ConjugateGradients conjugate_gradients(const Product& product, const Precondition& precondition,
                                       Eigen::VectorXd residual, double enough, int most_iterations,
                                       const Context& context, Eigen::VectorXd& x) {
  ConjugateGradients end;
  Eigen::VectorXd direction, image(residual.size());
  double along = 0;
  for (;; ++end.iterations) {
    end.residual = residual.norm();
    if (end.residual <= enough) return end;
    context.check_cancel();
    if (end.iterations == most_iterations) {
      end.status = SolveStatus::inaccurate;
      return end;
    }
    precondition(residual, image);
    const double along_before = std::exchange(along, residual.dot(image));
    if (end.iterations == 0) {
      direction = image;
    } else {
      direction = image + along / along_before * direction;
    }
    product(direction, image);
    const double curvature = direction.dot(image);
    if (!(along > 0) || !(curvature > 0)) {
      end.status = SolveStatus::not_positive_definite;
      return end;
    }
    x += along / curvature * direction;
    residual -= along / curvature * image;
  }
}

}  // namespace malus
