#pragma once

#include <Eigen/Core>

namespace malus {

// Doors to Eigen's decompositions of dense matrices whose size is known only when the program runs. They are compiled
// once, because each of them costs a source several seconds of the compiler's time (decision 83).

struct SymmetricEigen {
  Eigen::VectorXd values;   ///< ascending
  Eigen::MatrixXd vectors;  ///< in columns, orthonormal
};

SymmetricEigen symmetric_eigen(const Eigen::MatrixXd& matrix);

/// Solution of a symmetric, semidefinite system by Eigen's LDLT; one column for each column of `right`.
Eigen::MatrixXd solve_symmetric(const Eigen::MatrixXd& matrix, const Eigen::MatrixXd& right);

/// Square root of the sum of squares of points (columns, relative to their mean or another origin) along their
/// principal axes, the longest first: the singular values of the matrix.
Eigen::Vector3d principal_extents(const Eigen::Matrix3Xd& points);

}  // namespace malus
