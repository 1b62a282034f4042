#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/field_list.h"
#include "malus/core/image.h"
#include "malus/object/view.h"

namespace malus {

/// Points on a surface with its normals, world frame; 42 bytes each (46 with `scale`), as there may be tens of
/// millions.
struct OrientedPoints {
  std::vector<Eigen::Vector3d> points;
  std::vector<Eigen::Vector3f> normals;
  std::vector<float> sigma;             ///< one standard deviation along the normal
  std::vector<std::uint16_t> stations;  ///< how many stations see the place; 0 for points of stereo alone
  /// Side of the pixels that measured the place, in GSD of the object (the median of its stations'); empty if it is 1
  /// for all.
  std::vector<float> scale;

  std::size_t size() const { return points.size(); }
  /// Throws an input error unless all have as many values as there are points (or `scale` none).
  void validate() const;
};

/// Distances of the other stations' surfaces from the surface of one station, along this station's normals.
struct Agreement {
  std::string view;
  /// RMS of distance over its stated standard deviation, or the largest one that contradicts the place; NaN where no
  /// other station measured.
  Image<float> ratio;
  std::vector<double> distances;  ///< single ones; if there are millions, only those of every n-th pixel
  std::vector<double> expected;   ///< their standard deviations
  /// Number of other stations' surfaces, over all these pixels, that contradict the place: they lie more than twelve
  /// standard deviations away, and one of the two stations looks through the surface of the other.
  std::size_t contradictions = 0;
};

/// Over all places that two stations see; nothing without such places. Contradictions count only in
/// `contradicted_fraction`.
struct AgreementFigures {
  std::optional<double> rms_ratio;         ///< RMS of distance over standard deviation
  std::optional<double> within_two_sigma;  ///< share
  std::optional<double> rms_gsd, median_gsd;
  std::optional<double> contradicted_fraction;  ///< share of contradictions among all comparisons

  MALUS_FIELDS(rms_ratio, within_two_sigma, rms_gsd, median_gsd, contradicted_fraction)
};

AgreementFigures agreement_figures(std::span<const Agreement> agreements, double gsd);

struct CombinedViews {
  OrientedPoints points;
  std::vector<Agreement> agreements;  ///< one per view
};

/// The stations' surfaces as one set of points, each the mean of all stations that see it.
///
/// A station's weight is the inverse of its usual variance times the cosine of its viewing angle at the place. The
/// variances stated for single places are not used: they exaggerate the advantage of the frontal view (decision 90).
/// The standard deviation of a mean is the mean of those stated, not smaller: stations share a prior, so their errors
/// do not average out. A point is dropped if another station sees through it to a surface behind, or sees the place
/// better. A station with larger pixels does not replace the points of one with smaller pixels; it moves and tilts them
/// on average, without changing their detail. `cloud`: points of stereo. A place that only one station sees, at a flat
/// angle, may be a rim: it is kept only if the cloud has a surface there, too.
CombinedViews combine(std::span<const ObjectView> views, const OrientedPoints& cloud, const Context& context);

/// Points of the object's surface, from which any mesher can make a mesh: the means over the stations (`combine`), and
/// points of stereo's clouds where no station measured. Coarse points beside finer ones are left out, and so are
/// outliers.
OrientedPoints object_points(std::span<const ObjectView> views, std::span<const OrientedPoints> clouds,
                             const Context& context);

}  // namespace malus
