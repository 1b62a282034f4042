#pragma once

#include <Eigen/Core>
#include <vector>

#include "malus/core/context.h"

namespace malus {

/// Oriented points on a lattice whose nodes are the whole numbers; lengths in cells.
struct LatticePoints {
  std::vector<Eigen::Vector3d> at, normals;
  std::vector<double> reach;  ///< distance at which a point's weight becomes zero
};

/// The nodes first + (i, j, k) with 0 ≤ i, j, k < side.
struct NodeCube {
  Eigen::Vector3i first;
  int side = 0;
};

/// Signed distance [cells] of the nodes from a surface through the points, positive on the side of the normals: the
/// mean of the distances from the points' tangent planes (implicit moving least squares, Kolluri 2008), weighted by
/// Wendland's function of a point's distance over its reach. NaN where the weights together are not above least_weight.
/// The last coordinate varies fastest. A node's value does not depend on the cube that it is computed with.
std::vector<float> tangent_plane_mean(const LatticePoints& points, const NodeCube& nodes, double least_weight,
                                      const Context& context);

}  // namespace malus
