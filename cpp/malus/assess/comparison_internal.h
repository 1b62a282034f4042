#pragma once

#include <array>
#include <span>
#include <string_view>
#include <vector>

#include "malus/assess/statistics_internal.h"
#include "malus/core/context.h"
#include "malus/core/field_list.h"
#include "malus/core/geometry.h"
#include "malus/fusion/fused_surface.h"
#include "malus/options/surface_options.h"

namespace malus {

/// Similarity in the world frame: x_in_reference = scale · rotation · x_in_surface + translation.
struct SimilarityTransform {
  double scale = 1;
  std::array<double, 9> rotation{1, 0, 0, 0, 1, 0, 0, 0, 1};  ///< row major
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Eigen::Vector3d apply(const Eigen::Vector3d& x) const {
    using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    return scale * (Eigen::Map<const RowMajor>(rotation.data()) * x) + translation;
  }

  MALUS_FIELDS(scale, rotation, translation)
};

enum class ComparisonStatus { not_run, done, nothing_near, not_aligned, too_few_near };
constexpr auto names_of(ComparisonStatus) {
  return std::to_array<std::string_view>({"not run", "done", "no pixel near the reference",
                                          "the alignment did not come to rest",
                                          "too few pixels near the reference to align with it"});
}

/// Result of point-to-plane ICP.
struct PointAlignment {
  SimilarityTransform reference_from_surface;
  int iterations = 0;
  bool converged = false;
  bool too_few_near = false;  ///< it ended because fewer than 10 points were near the reference

  MALUS_FIELDS(reference_from_surface, iterations, converged)
};

/// Signed distances of a surface's pixels to a reference, positive = the surface is in front of it (outside).
struct ReferenceComparison {
  ComparisonStatus status = ComparisonStatus::not_run;
  Alignment alignment = Alignment::none;  ///< as requested in the options
  int alignment_iterations = 0;
  SimilarityTransform reference_from_surface;
  /// Share of the pixels with a depth that are within max_distance_gsd of the reference, and not beside it.
  double compared_fraction = 0;
  Summary distance_gsd;
  Histogram histogram_gsd;
  Image<float> distance;  ///< station view and unit, NaN = not compared; a map, not a field

  MALUS_FIELDS(status, alignment, alignment_iterations, reference_from_surface, compared_fraction, distance_gsd,
               histogram_gsd)
};

/// Compares every pixel's point with a reference in the world frame: a mesh, or a cloud if it has no triangles (see
/// ReferenceSurface). Outside is the side that most of the compared places turn to the camera, also if the mesh's
/// triangles are clockwise. With an alignment, point-to-plane ICP (Chen and Medioni 1992; Tukey weights, up to 20 000
/// evenly spread pixels, at most 60 steps) moves the surface first; motions that the shapes leave undetermined, such as
/// sliding along a plane, are not made, and none with fewer than 10 of these pixels near the reference. Without an
/// alignment nothing is moved, and only a similarity changes the scale. Pixels beside the reference, beyond its border,
/// have no distance. Throws a data error for a reference that cannot be used.
ReferenceComparison compare_with_reference(const FusedSurface& surface, const TriangleMesh& reference, double gsd,
                                           const AssessOptions& options, const Context& context);

/// The alignment of compare_with_reference for the points of any surface. All points are used except those farther from
/// the reference than options.max_distance_gsd · gsd.
/// Throws a data error for a reference that cannot be used.
PointAlignment align_with_reference(std::span<const Eigen::Vector3d> points, const TriangleMesh& reference, double gsd,
                                    const AssessOptions& options, const Context& context);

/// Signed distances of points of any surface from a reference, positive outside of it; NaN beyond
/// options.max_distance_gsd · gsd, and beside the reference unless `with_beside`. The outside of a reference cloud is
/// the side that `normals` (one per point) point to, so that the surface may be closed; that of a mesh is the side that
/// most of them point to. Nothing is moved. Throws a data error for a reference that cannot be used.
std::vector<float> distances_from_reference(std::span<const Eigen::Vector3d> points,
                                            std::span<const Eigen::Vector3d> normals, const TriangleMesh& reference,
                                            double gsd, const AssessOptions& options, const Context& context,
                                            bool with_beside = false);

}  // namespace malus
