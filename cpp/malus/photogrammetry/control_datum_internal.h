#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "malus/photogrammetry/scale_adjustment_internal.h"

namespace malus {

/// A point of known coordinates and its marks in photos of a model.
struct KnownPoint {
  std::string name;
  Eigen::Vector3d xyz = Eigen::Vector3d::Zero();  ///< station unit
  std::vector<PointMark> marks;
  bool check = false;  ///< held out: does not determine the datum
};

/// How well a known point fits, in the station's unit.
struct PointFit {
  std::string name;
  bool check = false;
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();  ///< point in the transformed model minus its known coordinates
  double rms_px = 0;                                 ///< distances of its marks from the image of the model's point

  MALUS_FIELDS(name, check, offset, rms_px)
};

/// Transformation of a model into the frame of known points: x_known = scale · rotation · x_model + translation.
struct Datum {
  double scale = 1;
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  double sigma = 0;  ///< standard deviation of a coordinate, from the residuals of the points that determine the datum
  std::optional<double> check_rms;      ///< RMS offset of a coordinate of the held-out points; none without such points
  std::optional<std::string> doubtful;  ///< point without which all other points fit far better: likely a mistake
  std::vector<PointFit> points;

  MALUS_FIELDS(scale, rotation, translation, sigma, check_rms, doubtful, points)
};

/// Datum of a photogrammetric model from known points that are marked in its photos: each point is where the rays of
/// its marks meet (`intersect_rays`). The similarity is the least-squares one over the points that are not held out
/// (Umeyama 1991).
///
/// Throws an input error for fewer than three determining points, points on one line, and points that do not fit (sigma
/// above 5 % of their extent), and the errors of `intersect_rays`.
Datum adjust_datum(std::span<const MarkedView> views, std::span<const KnownPoint> points);

}  // namespace malus
