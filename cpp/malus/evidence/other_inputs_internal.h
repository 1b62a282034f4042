#pragma once

// Private to the evidence room: what the input would be if somebody had mixed something up.

#include <Eigen/Geometry>
#include <cmath>
#include <string>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/geometry.h"
#include "malus/core/pose.h"
#include "malus/evidence/reduced_view_internal.h"

namespace malus {

/// The images as they would be if they had been turned or mirrored before they got here.
struct TurnedScene {
  std::string what, remedy;
  SceneView scene;
};

/// Turned by 180°, mirrored either way, and if the raster is square by 90° either way.
std::vector<TurnedScene> turned_scenes(const SceneView& scene);

/// How much of a cloud and of the object lie upon each other in the image.
struct CloudCoverage {
  double in_view = 0;    ///< share of the points that project into the image
  double on_object = 0;  ///< and onto the object
  double covered = 0;    ///< share of the object that has points, in cells of 1/32 of the image
};

/// object: of the size of the camera.
CloudCoverage cloud_coverage(const PointCloud& cloud, const Pinhole& camera, const Eigen::Affine3d& cam_from_cloud,
                             const Mask& object);

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
std::vector<MovedCloud> moved_clouds(const PointCloud& cloud, const Pose& pose, const Pinhole& camera,
                                     const Mask& object, const std::string& unit, std::size_t most);

Eigen::Affine3d affine_of(const Pose& pose);

}  // namespace malus
