#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "malus/assess/assess_options.h"
#include "malus/assess/statistics.h"
#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/fusion/fused_surface.h"

namespace malus {

/// Similarity in the world frame: x_in_reference = scale · rotation · x_in_surface + translation.
struct SimilarityTransform {
  double scale = 1;
  std::array<double, 9> rotation{1, 0, 0, 0, 1, 0, 0, 0, 1};  ///< row major
  std::array<double, 3> translation{};

  Eigen::Vector3d apply(const Eigen::Vector3d& x) const {
    using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    return scale * (Eigen::Map<const RowMajor>(rotation.data()) * x) +
           Eigen::Map<const Eigen::Vector3d>(translation.data());
  }

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("scale", self.scale);
    visit("rotation", self.rotation);
    visit("translation", self.translation);
  }
};

/// Where point-to-plane ICP has moved points to.
struct PointAlignment {
  SimilarityTransform reference_from_surface;
  int iterations = 0;
  bool converged = false;
};

/// Signed distances of a surface's pixels to a reference, positive = the surface is in front of it (outside).
struct ReferenceComparison {
  std::string status = "not run";  ///< "done" | "no pixel near the reference" | "alignment did not converge"
  std::string alignment = "none";  ///< Alignment that was asked for
  int alignment_iterations = 0;
  SimilarityTransform reference_from_surface;
  double compared_fraction = 0;  ///< pixels within max_distance_gsd of the reference, of those with a depth
  Summary distance_gsd;
  Histogram histogram_gsd;
  Image<float> distance;  ///< station view and unit, NaN = not compared; a map, not a field

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("status", self.status);
    visit("alignment", self.alignment);
    visit("alignment_iterations", self.alignment_iterations);
    visit("reference_from_surface", self.reference_from_surface);
    visit("compared_fraction", self.compared_fraction);
    visit("distance_gsd", self.distance_gsd);
    visit("histogram_gsd", self.histogram_gsd);
  }
};

/// Compares every pixel's point with a reference in the world frame: a mesh (outward = counter-clockwise), or a cloud
/// if it has no triangles (see ReferenceSurface). With an alignment, point-to-plane ICP (Chen and Medioni 1992; Tukey
/// weights, up to 20 000 evenly spread pixels, at most 60 steps) moves the surface first; motions that the shapes leave
/// free, such as sliding along a plane, are not made. Nothing is rescaled or moved without being asked for.
/// Throws a data error for a reference that cannot be used.
ReferenceComparison compare_with_reference(const FusedSurface& surface, const TriangleMesh& reference, double gsd,
                                           const AssessOptions& options, const Context& context);

/// The alignment of compare_with_reference for points of any surface, all of which count; points farther from the
/// reference than options.max_distance_gsd · gsd do not.
/// Throws a data error for a reference that cannot be used.
PointAlignment align_with_reference(std::span<const Eigen::Vector3d> points, const TriangleMesh& reference, double gsd,
                                    const AssessOptions& options, const Context& context);

/// Signed distances of points of any surface from a reference, positive outside of it; NaN beyond
/// options.max_distance_gsd · gsd. The outside of a cloud is where the points' own `normals` (as many) point to, so
/// that the surface may go all around. Nothing is moved. Throws a data error for a reference that cannot be used.
std::vector<float> distances_from_reference(std::span<const Eigen::Vector3d> points,
                                            std::span<const Eigen::Vector3d> normals, const TriangleMesh& reference,
                                            double gsd, const AssessOptions& options, const Context& context);

}  // namespace malus
