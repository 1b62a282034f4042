#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include "malus/core/dense_systems_internal.h"

namespace malus {

SymmetricEigen symmetric_eigen(const Eigen::MatrixXd& matrix) {
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(matrix);
  return {solver.eigenvalues(), solver.eigenvectors()};
}

Eigen::MatrixXd solve_symmetric(const Eigen::MatrixXd& matrix, const Eigen::MatrixXd& right) {
  return matrix.ldlt().solve(right);
}

Eigen::Vector3d principal_extents(const Eigen::Matrix3Xd& points) {
  const Eigen::Matrix3d moments = points * points.transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(moments, Eigen::EigenvaluesOnly);
  return solver.eigenvalues().reverse().cwiseMax(0).cwiseSqrt();
}

}  // namespace malus
