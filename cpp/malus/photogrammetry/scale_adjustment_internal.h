#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/field_list.h"
#include "malus/core/pose.h"
#include "malus/photogrammetry/adjustment_status_internal.h"

namespace malus {

/// A photo of the model: its camera, and its pose in the model's frame and unit.
struct MarkedView {
  std::string name;
  LensCamera camera;
  Pose pose;
};

/// Where a photo shows a point, memory pixel convention.
struct PointMark {
  std::size_t view = 0;  ///< index of the photo
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  double sigma_px = 0.3;  ///< standard deviation of each coordinate
};

/// A distance between two marked points.
struct KnownDistance {
  std::string name;     ///< for messages, such as "[[scale]] 2"
  double distance = 0;  ///< in the station's unit
  double sigma = 0;     ///< its standard deviation, same unit
  std::vector<PointMark> a, b;
  bool check = false;  ///< held out: does not determine the scale
};

/// Result for one distance, in the station's unit.
struct DistanceFit {
  std::string name;
  bool check = false;
  double distance = 0;  ///< as given
  double adjusted = 0;  ///< as measured in the scaled model
  double residual = 0;  ///< adjusted − given
  double sigma = 0;  ///< expected standard deviation of a held-out distance's residual, from marks, distances and scale
  double rms_px = 0;        ///< of the distances of its marks from their point's image
  double worst_px = 0;      ///< the largest of these distances
  std::string worst_image;  ///< photo of that mark

  MALUS_FIELDS(name, check, distance, adjusted, residual, sigma, rms_px, worst_px, worst_image)
};

/// Outcome of the adjustment.
struct ScaleAdjustment {
  AdjustmentStatus status = AdjustmentStatus::not_run;
  double scale = 1;        ///< station units per model unit
  double sigma = 0;        ///< standard deviation of the scale
  double unit_weight = 1;  ///< a posteriori standard deviation of unit weight; 1 = marks as good as stated
  int redundancy = 0;      ///< observations minus unknowns
  std::vector<DistanceFit> distances;

  MALUS_FIELDS(status, scale, sigma, unit_weight, redundancy, distances)
};

/// Scale of a photogrammetric model from known distances between points marked in its photos.
///
/// One least-squares adjustment of the points (3 coordinates each, model frame) and the logarithm λ of the scale, with
/// cameras and poses fixed. Observations: marks, whose residual is the distance of the undistorted mark from the
/// point's projection times the focal length; distances, with residual e^λ |a − b| − d. Gauss–Newton from the points
/// nearest to the marks' rays. `sigma` is from the inverse normal matrix, times max(1, unit_weight).
///
/// Throws an input error for a distance with fewer than two marks at an end, or marks in a view that does not exist,
/// and a data error if no distance determines the scale, or if the rays of an end meet behind a camera or are too close
/// to parallel (under 1°) to determine its position.
ScaleAdjustment adjust_scale(std::span<const MarkedView> views, std::span<const KnownDistance> distances,
                             const Context& context);

/// Point nearest to the rays of its marks; throws the errors above. `name` is for messages.
Eigen::Vector3d intersect_rays(std::span<const MarkedView> views, std::span<const PointMark> marks,
                               const std::string& name);

}  // namespace malus
