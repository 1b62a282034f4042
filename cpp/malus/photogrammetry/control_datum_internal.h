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
  Eigen::Vector3d offset =
      Eigen::Vector3d::Zero();  ///< where the moved model has the point, less where it is known to be
  double rms_px = 0;            ///< of its marks to the point that the model has

  MALUS_FIELDS(name, check, offset, rms_px)
};

/// How a model stands in the frame of known points: x_known = scale · rotation · x_model + translation.
struct Datum {
  double scale = 1;
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  double sigma = 0;  ///< standard deviation of a coordinate, by the residuals of the points that determine the datum
  std::optional<double> check_rms;  ///< RMS offset of a coordinate of the points that are held out; none without them
  std::optional<std::string> doubtful;  ///< point without which all others fit far better: likely a mistake
  std::vector<PointFit> points;

  MALUS_FIELDS(scale, rotation, translation, sigma, check_rms, doubtful, points)
};

/// Datum of a photogrammetric model from known points that are marked in its photos: each is where the rays of its
/// marks meet (`intersect_rays`), and the similarity is that of least squares over points that are not held out
/// (Umeyama 1991).
///
/// Throws an input error for fewer than three points that determine it, points on one line, and points that do not fit
/// (sigma above 5 % of their extent); errors of `intersect_rays`.
Datum adjust_datum(std::span<const MarkedView> views, std::span<const KnownPoint> points);

}  // namespace malus
