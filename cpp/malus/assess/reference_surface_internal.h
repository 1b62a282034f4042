#pragma once

#include <Eigen/Core>
#include <optional>

#include "malus/assess/box_tree_internal.h"
#include "malus/core/context.h"
#include "malus/core/geometry.h"

namespace malus {

/// Nearest place on a reference surface to a point.
struct Foot {
  Eigen::Vector3d point;       ///< nearest point of the surface
  Eigen::Vector3d normal;      ///< unit, outward
  double signed_distance = 0;  ///< positive outside
  /// The point lies beside the reference, beyond its border: the distance is not one in front of it or behind it.
  bool is_beside = false;
  /// Of a cloud: scatter of the nearest points across their plane relative to that along it, as a ratio of variances.
  /// Near 1 the plane has no direction. 0 of a mesh.
  double thickness = 0;
  /// Of a cloud: the place lies no farther from the nearest points than these reach.
  bool is_among = false;
  /// Of a cloud: the nearest points lie along a line, so that they determine no plane.
  bool is_on_line = false;
};

/// A reference surface to measure distances from: a mesh, or a cloud if it has no triangles.
class ReferenceSurface {
 public:
  /// `viewpoint`: the outward side of a cloud without normals faces it. `neighbors` as in AssessOptions. Throws a data
  /// error if there are no points, points are not finite, or triangles name vertices that do not exist. Keeps a
  /// reference to the geometry, which must outlive this object.
  ReferenceSurface(const TriangleMesh& geometry, const Eigen::Vector3d& viewpoint, int neighbors,
                   const Context& context);

  /// Nearest point within max_distance, if any.
  ///
  /// Mesh: exact point-to-triangle distance; its sign is that of the angle-weighted pseudonormal (Bærentzen and Aanæs
  /// 2005), so that edges and corners are right too. Cloud: signed distance to the total least squares plane through
  /// the `neighbors` nearest points; max_distance is to the nearest of them. A point lies beside a mesh if it is seen
  /// from the nearest place more than 60° off the normal there, and beside a cloud if its foot lies farther from the
  /// middle of these points than all of them, or if these points lie along a line.
  std::optional<Foot> foot(const Eigen::Vector3d& point, double max_distance) const;

 private:
  std::optional<Foot> foot_on_mesh(const Eigen::Vector3d& point, double max_distance) const;
  std::optional<Foot> foot_on_cloud(const Eigen::Vector3d& point, double max_distance) const;

  const TriangleMesh& geometry_;
  Eigen::Vector3d viewpoint_;
  std::size_t neighbors_;
  double extent_ = 0;  ///< diagonal of the box about all points
  BoxTree tree_;
};

}  // namespace malus
