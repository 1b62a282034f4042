#pragma once

// Private to the evidence room: variants of the input that undo a likely mix-up.

#include <Eigen/Geometry>
#include <cmath>
#include <string>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/geometry.h"
#include "malus/core/pose.h"
#include "malus/evidence/reduced_view_internal.h"

namespace malus {

/// A turn or mirroring of the images before Malus reads them. A pixel's content belongs at (u, v) of the correct image,
/// at (v, u) if exchanged, and counted from the other end if flipped.
struct ImageTurn {
  std::string what, remedy;
  bool exchanges = false, flips_u = false, flips_v = false;
};

/// Turns by 180°, mirroring either way, and, for a square raster, turns by 90° either way.
std::vector<ImageTurn> image_turns(Size size);

/// The scene without the turn. The values of polarization stay unchanged: only exp(4i phase) is compared, which a
/// quarter turn does not change.
SceneView undone(const SceneView& scene, const ImageTurn& turn);

/// How much a cloud and the object overlap in the image.
struct CloudCoverage {
  double in_view = 0;    ///< share of the points that project into the image
  double on_object = 0;  ///< share of the points that project onto the object
  double covered = 0;    ///< share of the object's cells that have points
};

/// Measures how much of the object a cloud covers. camera and object have the same size and must outlive this counter.
/// cells_per_side: number of cells along the image's larger side.
class CoverageCounter {
 public:
  CoverageCounter(const Pinhole& camera, const Mask& object, int cells_per_side = 32);

  /// Uses a few thousand of the cloud's points, so that each of many variants takes a millisecond.
  CloudCoverage operator()(const PointCloud& cloud, const Eigen::Affine3d& cam_from_cloud) const;

 private:
  const Pinhole& camera_;
  const Mask& object_;
  int cell_px_;
  Mask cells_with_object_;
};

/// The cloud in another unit, with its axes exchanged or negated, or with the inverse pose.
struct MovedCloud {
  std::string what, remedy;
  Eigen::Affine3d cam_from_cloud;
  double likelihood = 1;  ///< of this mistake: feet and inches are rare
  CloudCoverage coverage = {};

  /// In tenths: of variants that are about as good, the first one wins, which changes least.
  double rank() const { return std::floor(10 * likelihood * std::sqrt(coverage.on_object * coverage.covered)); }
};

/// The variants that cover the object best, best first, at most `most`.
std::vector<MovedCloud> moved_clouds(const PointCloud& cloud, const Pose& pose, const CoverageCounter& coverage_of,
                                     const std::string& unit, std::size_t most);

Eigen::Affine3d affine_of(const Pose& pose);

}  // namespace malus
