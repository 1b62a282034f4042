#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <sstream>

#include "malus/core/better_fit_internal.h"
#include "malus/core/dense_systems_internal.h"
#include "malus/core/digits_internal.h"
#include "malus/core/error.h"
#include "malus/photogrammetry/control_datum_internal.h"

namespace malus {
namespace {

using Points = Eigen::Matrix3Xd;

/// Points that determine a datum, in both frames.
struct Pairs {
  Points model, known;
};

Pairs without(const Pairs& pairs, Eigen::Index left_out) {
  std::vector<Eigen::Index> kept;
  for (Eigen::Index i = 0; i < pairs.model.cols(); ++i) {
    if (i != left_out) kept.push_back(i);
  }
  return {pairs.model(Eigen::all, kept), pairs.known(Eigen::all, kept)};
}

bool on_one_line(const Points& points) {
  constexpr double least_width = 1e-3;
  const Points centered = points.colwise() - points.rowwise().mean();
  const Eigen::Vector3d extents = principal_extents(centered);
  return !(extents[1] > least_width * extents[0]);
}

/// The least-squares similarity, computed about the points' means so that large coordinates, such as a national grid's,
/// lose no digits.
Eigen::Matrix4d similarity(const Pairs& pairs) {
  const Eigen::Vector3d model_mean = pairs.model.rowwise().mean(), known_mean = pairs.known.rowwise().mean();
  const Points model = pairs.model.colwise() - model_mean, known = pairs.known.colwise() - known_mean;
  Eigen::Matrix4d motion = Eigen::umeyama(model, known, true);
  motion.topRightCorner<3, 1>() += known_mean - motion.topLeftCorner<3, 3>() * model_mean;
  return motion;
}

double squared_residuals(const Pairs& pairs, const Eigen::Matrix4d& motion) {
  const Points moved = (motion.topLeftCorner<3, 3>() * pairs.model).colwise() + motion.topRightCorner<3, 1>().eval();
  return (moved - pairs.known).squaredNorm();
}

/// Standard deviation of a coordinate.
double sigma_of(double squares, Eigen::Index points) {
  return std::sqrt(squares / static_cast<double>(3 * points - 7));
}

/// Size of the photos' pixels at the points, unit of the model.
double pixel_size(std::span<const MarkedView> views, std::span<const KnownPoint> points,
                  const std::vector<Eigen::Vector3d>& found) {
  double sum = 0, count = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    for (const PointMark& mark : points[i].marks) {
      const MarkedView& view = views[mark.view];
      sum += view.pose.cam_from_world(found[i]).z() / view.camera.pinhole().focal();
      ++count;
    }
  }
  return sum / count;
}

/// A point that is likely wrong, and the standard deviation of the other points' fit without it.
struct Doubt {
  Eigen::Index index = 0;
  double sigma = 0;
};

/// The point without which the other points fit far better than chance explains. Not searched if all points fit to a
/// pixel.
std::optional<Doubt> doubtful_point(const Pairs& pairs, double squares, double pixel) {
  const Eigen::Index count = pairs.model.cols();
  if (static_cast<std::size_t>(count) < BetterFit::least_points || !(sigma_of(squares, count) > pixel))
    return std::nullopt;
  BetterFit fit{
      .all = squares, .others = squares, .points = static_cast<double>(count), .coordinates = 3, .unknowns = 7};
  Doubt doubt;
  for (Eigen::Index i = 0; i < count; ++i) {
    const Pairs others = without(pairs, i);
    if (on_one_line(others.known)) continue;
    const double left = squared_residuals(others, similarity(others));
    if (left < fit.others) fit.others = left, doubt = {i, sigma_of(left, count - 1)};
  }
  return fit.is_telling() ? std::optional(doubt) : std::nullopt;
}

double mark_rms_px(std::span<const MarkedView> views, const KnownPoint& known, const Eigen::Vector3d& point) {
  double squares = 0;
  for (const PointMark& mark : known.marks) {
    const MarkedView& view = views[mark.view];
    squares += (view.camera.project(view.pose.cam_from_world(point)) - mark.pixel).squaredNorm();
  }
  return std::sqrt(squares / static_cast<double>(known.marks.size()));
}

/// RMS offset of a coordinate of the held-out points.
std::optional<double> rms_of_checks(const std::vector<PointFit>& points) {
  double squares = 0, coordinates = 0;
  for (const PointFit& fit : points) {
    if (!fit.check) continue;
    squares += fit.offset.squaredNorm();
    coordinates += 3;
  }
  return coordinates > 0 ? std::optional(std::sqrt(squares / coordinates)) : std::nullopt;
}

void require_fit(const Datum& datum, const Points& known, const std::optional<Doubt>& doubt) {
  constexpr double tolerated_share = 0.05;
  const double extent = (known.rowwise().maxCoeff() - known.rowwise().minCoeff()).norm();
  if (datum.sigma <= tolerated_share * extent) return;
  std::ostringstream message;
  message << "[[control]]: coordinates and marks do not fit, " << with_digits(datum.sigma, 3) << " off over "
          << with_digits(extent, 3) << "; ";
  if (doubt && doubt->sigma <= tolerated_share * extent) {
    message << "without point " << *datum.doubtful << " the others do: are its marks and its coordinates right?";
  } else {
    const auto& worst = *std::ranges::max_element(
        datum.points, {}, [](const PointFit& fit) { return fit.check ? -1 : fit.offset.norm(); });
    message << "the worst is point " << worst.name
            << ". Is each mark that of its point, and are the axes right-handed?";
  }
  throw input_error(message.str());
}

}  // namespace

Datum adjust_datum(std::span<const MarkedView> views, std::span<const KnownPoint> points) {
  constexpr Eigen::Index least_points = 3;
  std::vector<Eigen::Vector3d> found;
  std::vector<std::size_t> used;
  for (std::size_t i = 0; i < points.size(); ++i) {
    found.push_back(intersect_rays(views, points[i].marks, "[[control]] " + points[i].name));
    if (!points[i].check) used.push_back(i);
  }
  const auto count = static_cast<Eigen::Index>(used.size());
  if (count < least_points)
    throw input_error("[[control]]: " + std::to_string(count) +
                      " points without check = true are marked in two registered photos or more, expected at least 3 "
                      "to find the frame");
  Pairs pairs{Points(3, count), Points(3, count)};
  for (Eigen::Index i = 0; i < count; ++i) {
    pairs.model.col(i) = found[used[static_cast<std::size_t>(i)]];
    pairs.known.col(i) = points[used[static_cast<std::size_t>(i)]].xyz;
  }
  if (on_one_line(pairs.known))
    throw input_error("[[control]]: the points lie on one line or at one place, expected points that span an area");

  const Eigen::Matrix4d motion = similarity(pairs);
  Datum datum;
  datum.scale = std::cbrt(motion.topLeftCorner<3, 3>().determinant());
  datum.rotation = motion.topLeftCorner<3, 3>() / datum.scale;
  datum.translation = motion.topRightCorner<3, 1>();
  const double squares = squared_residuals(pairs, motion);
  datum.sigma = sigma_of(squares, count);
  const auto doubt = doubtful_point(pairs, squares, datum.scale * pixel_size(views, points, found));
  if (doubt) datum.doubtful = points[used[static_cast<std::size_t>(doubt->index)]].name;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3d moved = datum.scale * datum.rotation * found[i] + datum.translation;
    datum.points.push_back(
        {points[i].name, points[i].check, moved - points[i].xyz, mark_rms_px(views, points[i], found[i])});
  }
  datum.check_rms = rms_of_checks(datum.points);
  require_fit(datum, pairs.known, doubt);
  return datum;
}

}  // namespace malus
