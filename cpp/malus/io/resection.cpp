#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <opencv2/core/eigen.hpp>
#include <sstream>

#include "malus/core/better_fit_internal.h"
#include "malus/core/dense_systems_internal.h"
#include "malus/core/digits_internal.h"
#include "malus/core/error.h"
#include "malus/io/resection_internal.h"

namespace malus {
namespace {

// If the extent of points across is less than this share of their length, they lie on a line, or near a plane.
constexpr double least_width = 1e-3, least_thickness = 0.02;

/// Points and marks in OpenCV's types. Coordinates are relative to their mean, so that those of a national grid lose no
/// digits.
struct Marked {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  std::vector<cv::Point3d> points;
  std::vector<cv::Point2d> ideal;  ///< direction (x/z, y/z) of each mark
};

/// A pose relative to the points' mean, in OpenCV's types.
struct Solution {
  cv::Mat turn, shift;  ///< rotation vector and translation
  double rms = 0;       ///< of the marks, in ideal coordinates
};

Marked marked_points(const std::vector<MarkedPoint>& points, const LensCamera& lens) {
  Marked marked;
  for (const MarkedPoint& point : points) marked.origin += point.xyz / static_cast<double>(points.size());
  for (const MarkedPoint& point : points) {
    const Eigen::Vector3d x = point.xyz - marked.origin;
    const Eigen::Vector2d ideal = lens.undistort(point.pixel);
    marked.points.emplace_back(x.x(), x.y(), x.z());
    marked.ideal.emplace_back(ideal.x(), ideal.y());
  }
  return marked;
}

/// Extents of the points along their principal axes, longest first.
Eigen::Vector3d extents(const Marked& marked) {
  Eigen::Matrix3Xd matrix(3, static_cast<Eigen::Index>(marked.points.size()));
  for (std::size_t i = 0; i < marked.points.size(); ++i)
    matrix.col(static_cast<Eigen::Index>(i)) << marked.points[i].x, marked.points[i].y, marked.points[i].z;
  return principal_extents(matrix);
}

/// Least squares on the marks from a start.
Solution refined(const Marked& marked, Solution solution) {
  cv::solvePnPRefineLM(marked.points, marked.ideal, cv::Matx33d::eye(), cv::noArray(), solution.turn, solution.shift);
  std::vector<cv::Point2d> seen;
  cv::projectPoints(marked.points, solution.turn, solution.shift, cv::Matx33d::eye(), cv::noArray(), seen);
  double squares = 0;
  for (std::size_t i = 0; i < seen.size(); ++i) squares += (seen[i] - marked.ideal[i]).dot(seen[i] - marked.ideal[i]);
  solution.rms = std::sqrt(squares / static_cast<double>(seen.size()));
  return solution;
}

/// All candidate poses, the best first; empty if OpenCV finds none.
std::vector<Solution> solutions(const Marked& marked, bool flat) {
  std::vector<Solution> found;
  for (const int method : {cv::SOLVEPNP_SQPNP, cv::SOLVEPNP_IPPE}) {
    if (method == cv::SOLVEPNP_IPPE && !flat) continue;
    std::vector<cv::Mat> turns, shifts;
    cv::solvePnPGeneric(marked.points, marked.ideal, cv::Matx33d::eye(), cv::noArray(), turns, shifts, false,
                        static_cast<cv::SolvePnPMethod>(method));
    for (std::size_t i = 0; i < turns.size(); ++i) found.push_back(refined(marked, {turns[i], shifts[i]}));
  }
  std::ranges::sort(found, {}, &Solution::rms);
  return found;
}

/// The best of the solutions, which must be the only one that fits.
Solution decided(const std::vector<Solution>& found, double focal_px, const std::string& where) {
  constexpr double least_rms_px = 0.3, distinct = 3, same_turn_rad = 0.02;
  if (found.empty()) throw input_error(where + ": no position of the camera sees the points at their marks");
  const double limit = distinct * std::max(found.front().rms, least_rms_px / focal_px);
  for (const Solution& other : found) {
    cv::Mat rotation, other_rotation, between;
    cv::Rodrigues(found.front().turn, rotation);
    cv::Rodrigues(other.turn, other_rotation);
    cv::Rodrigues(cv::Mat(rotation.t() * other_rotation), between);
    if (cv::norm(between) > same_turn_rad && other.rms < limit)
      throw input_error(where +
                        ": two positions of the camera fit the marks alike, since the points lie in one plane and "
                        "perspective is weak; add a point that is clearly out of this plane");
  }
  return found.front();
}

Pose pose_of(const Solution& solution, const Eigen::Vector3d& origin) {
  cv::Mat rotation;
  cv::Rodrigues(solution.turn, rotation);
  Pose pose;
  cv::cv2eigen(rotation, pose.rotation);
  cv::cv2eigen(solution.shift, pose.translation);
  pose.translation -= pose.rotation * origin;
  return pose;
}

/// Standard deviation of the center along its most uncertain direction, for marks with the standard deviation
/// `mark_sigma` (ideal coordinates).
double center_sigma(const Marked& marked, const Solution& solution, double mark_sigma) {
  std::vector<cv::Point2d> seen;
  cv::Mat jacobian;
  cv::projectPoints(marked.points, solution.turn, solution.shift, cv::Matx33d::eye(), cv::noArray(), seen, jacobian);
  Eigen::MatrixXd by_pose;
  cv::cv2eigen(cv::Mat(jacobian.colRange(0, 6)), by_pose);
  const Eigen::MatrixXd covariance = mark_sigma * mark_sigma * (by_pose.transpose() * by_pose).inverse();
  Eigen::Matrix<double, 3, 6> center_by_pose;
  for (int k = 0; k < 6; ++k) {
    const double step = 1e-6 * (k < 3 ? 1 : cv::norm(solution.shift));
    const auto moved = [&](double by) {
      Solution other{solution.turn.clone(), solution.shift.clone()};
      (k < 3 ? other.turn : other.shift).at<double>(k % 3) += by;
      return pose_of(other, Eigen::Vector3d::Zero()).center();
    };
    center_by_pose.col(k) = (moved(step) - moved(-step)) / (2 * step);
  }
  const Eigen::Matrix3d of_center = center_by_pose * covariance * center_by_pose.transpose();
  return std::sqrt(Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(of_center).eigenvalues()[2]);
}

double rms_px(const std::vector<MarkedPoint>& points, const LensCamera& lens, const Pose& pose) {
  double squares = 0;
  for (const MarkedPoint& point : points) squares += mark_residual(point, lens, pose).squaredNorm();
  return std::sqrt(squares / static_cast<double>(points.size()));
}

/// A point that is likely wrong, and how well the other points fit without it.
struct Doubt {
  std::string name;
  double rms_px = 0;
};

/// The point without which the other points fit far better than chance explains, if there is one.
std::optional<Doubt> doubtful_point(const std::vector<MarkedPoint>& points, const LensCamera& lens, double rms) {
  constexpr double worth_a_search_px = 1;
  if (points.size() < BetterFit::least_points || !(rms > worth_a_search_px)) return std::nullopt;
  const auto count = static_cast<double>(points.size());
  BetterFit fit{
      .all = rms * rms * count, .others = rms * rms * count, .points = count, .coordinates = 2, .unknowns = 6};
  Doubt doubt;
  for (std::size_t left_out = 0; left_out < points.size(); ++left_out) {
    std::vector<MarkedPoint> others = points;
    others.erase(others.begin() + static_cast<std::ptrdiff_t>(left_out));
    const Marked marked = marked_points(others, lens);
    const Eigen::Vector3d extent = extents(marked);
    if (!(extent[1] > least_width * extent[0])) continue;
    const std::vector<Solution> found = solutions(marked, extent[2] < least_thickness * extent[0]);
    if (found.empty()) continue;
    const double without = rms_px(others, lens, pose_of(found.front(), marked.origin));
    const double squares = without * without * (count - 1);
    if (squares < fit.others) fit.others = squares, doubt = {points[left_out].name, without};
  }
  return fit.is_telling() ? std::optional(doubt) : std::nullopt;
}

double tolerated_px(const LensCamera& lens) {
  constexpr double tolerated_share = 0.01;
  return tolerated_share * std::max(lens.size.width, lens.size.height);
}

/// Message why marks and coordinates are refused.
std::string misfit(const std::vector<MarkedPoint>& points, const LensCamera& lens, const Resection& found,
                   const std::optional<Doubt>& doubt) {
  std::ostringstream message;
  message << "marks and coordinates do not fit, " << with_digits(found.rms_px, 3) << " px RMS; ";
  if (doubt && doubt->rms_px <= tolerated_px(lens)) {
    message << "without point " << doubt->name << " the others do: are its mark and its coordinates right?";
    return message.str();
  }
  const auto off = [&](const MarkedPoint& point) { return mark_residual(point, lens, found.pose).norm(); };
  const MarkedPoint& worst = *std::ranges::max_element(points, {}, off);
  message << "the worst is point " << worst.name << ", " << with_digits(off(worst), 3)
          << " px off. Is each mark that of its point?";
  return message.str();
}

}  // namespace

Eigen::Vector2d mark_residual(const MarkedPoint& point, const LensCamera& lens, const Pose& pose) {
  const Eigen::Vector3d in_cam = pose.cam_from_world(point.xyz);
  if (!(in_cam.z() > 0)) return Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  return point.pixel - lens.project(in_cam);
}

Resection resect(const std::vector<MarkedPoint>& points, const LensCamera& lens, const std::string& where) {
  constexpr std::size_t least_points = 4;
  constexpr double least_mark_sigma_px = 0.1;
  if (points.size() < least_points)
    throw input_error(where + ": " + std::to_string(points.size()) +
                      " points are marked in the polarized image without check = true, expected at least 4 to find the "
                      "camera's position");
  for (const MarkedPoint& point : points) {
    if (!point.xyz.allFinite() || !point.pixel.allFinite())
      throw input_error(where + ": point " + point.name + " has a coordinate or a mark that is not a finite number");
    if (!lens.undistort(point.pixel).allFinite())
      throw input_error(where + ": the lens sends no ray to the mark of point " + point.name +
                        ": so far out its distortion bends back");
  }
  const Marked marked = marked_points(points, lens);
  const Eigen::Vector3d extent = extents(marked);
  if (!(extent[1] > least_width * extent[0]))
    throw input_error(where + ": the points lie on one line or at one place, expected points that span an area");
  const double focal_px = lens.pinhole().focal();
  const Solution best = decided(solutions(marked, extent[2] < least_thickness * extent[0]), focal_px, where);
  Resection result;
  result.pose = pose_of(best, marked.origin);
  for (const MarkedPoint& point : points)
    if (mark_residual(point, lens, result.pose).hasNaN())
      throw input_error(where + ": point " + point.name + " would be behind the camera; are its coordinates right?");
  result.rms_px = rms_px(points, lens, result.pose);
  const std::optional<Doubt> doubt = doubtful_point(points, lens, result.rms_px);
  if (result.rms_px > tolerated_px(lens)) throw input_error(where + ": " + misfit(points, lens, result, doubt));
  if (doubt) result.doubtful = doubt->name;
  const double count = static_cast<double>(points.size());
  const double mark_sigma_px = std::max(result.rms_px * std::sqrt(count / (2 * count - 6)), least_mark_sigma_px);
  result.center_sigma = center_sigma(marked, best, mark_sigma_px / focal_px);
  return result;
}

}  // namespace malus
