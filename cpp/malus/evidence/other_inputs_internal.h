#pragma once

// Private to the evidence room: what the input would be if somebody had mixed something up.

#include <Eigen/Geometry>
#include <cmath>
#include <string>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/geometry.h"
#include "malus/core/pose.h"
#include "malus/evidence/reduced_view.h"

namespace malus {

/// Images that were turned or mirrored before they got here: what each of their pixels shows is at (u, v), or (v, u) if
/// exchanged, of the image as it would be, counted from the other end if flipped.
struct ImageTurn {
  std::string what, remedy;
  bool exchanges = false, flips_u = false, flips_v = false;
};

/// Turned by 180°, mirrored either way, and if the raster is square by 90° either way.
std::vector<ImageTurn> image_turns(Size size);

/// The scene as it would be without the turn. Polarization stays as it is: exp(4i phase), which is compared, is the
/// same after a quarter turn.
SceneView undone(const SceneView& scene, const ImageTurn& turn);

/// How much of a cloud and of the object lie upon each other in the image.
struct CloudCoverage {
  double in_view = 0;    ///< share of the points that project into the image
  double on_object = 0;  ///< and onto the object
  double covered = 0;    ///< share of the object that has points, in cells of 1/32 of the image
};

/// Counts how much of the object clouds cover. camera and object, of one size, have to outlive it.
class CoverageCounter {
 public:
  CoverageCounter(const Pinhole& camera, const Mask& object);

  /// Of some thousand of the cloud's points, so that each of many ideas takes a millisecond.
  CloudCoverage operator()(const PointCloud& cloud, const Eigen::Affine3d& cam_from_cloud) const;

 private:
  const Pinhole& camera_;
  const Mask& object_;
  int cell_px_;
  Mask cells_with_object_;
};

/// The cloud as it would be in another unit, with its axes exchanged or negated, or with a pose that goes the other
/// way.
struct MovedCloud {
  std::string what, remedy;
  Eigen::Affine3d cam_from_cloud;
  double likelihood = 1;  ///< of the mistake: feet and inches are rare
  CloudCoverage coverage = {};

  /// In tenths, so that of ideas that do about as well the first is taken, which changes least.
  double rank() const { return std::floor(10 * likelihood * std::sqrt(coverage.on_object * coverage.covered)); }
};

/// Those that cover the object best, best first, at most `most`.
std::vector<MovedCloud> moved_clouds(const PointCloud& cloud, const Pose& pose, const CoverageCounter& coverage_of,
                                     const std::string& unit, std::size_t most);

Eigen::Affine3d affine_of(const Pose& pose);

}  // namespace malus
