#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <utility>
#include <vector>

#include "malus/core/degrees_internal.h"
#include "malus/core/digits_internal.h"
#include "malus/core/error.h"
#include "malus/core/length_unit_internal.h"
#include "malus/core/median_internal.h"
#include "malus/evidence/object_size_internal.h"

namespace malus {
namespace {

constexpr double smallest_m = 1e-3, largest_m = 100, nearest_m = 5e-3, farthest_m = 200;
/// Range of sizes and distances that are usual in front of a camera.
constexpr double usual_smallest_m = 5e-3, usual_largest_m = 20;
constexpr double narrowest_deg = 0.3, widest_deg = 140;
/// Turn of the normals by the rounding of depths from which the finding is a caution: the error of the best normals.
constexpr double largest_rounding_deg = 0.5;

/// A length with three digits in a unit that suits it.
std::string in_words(double meters) {
  const double size = std::abs(meters);
  const auto [scale, name] = size < 1e-3   ? std::pair(1e6, "µm")
                             : size < 0.5  ? std::pair(1e3, "mm")
                             : size < 2000 ? std::pair(1.0, "m")
                                           : std::pair(1e-3, "km");
  return with_digits(meters * scale, 3) + " " + name;
}

/// Number of points whose median depth is that of a place.
constexpr std::size_t points_of_place = 9;

using SeenAlongAxis = std::vector<std::pair<double, double>>;  // slope of the ray, depth

/// Where the first of these points lies across the view. Its direction is no outlier, because all points are on the
/// object in the image, but its depth may be one, at a contour: it is the median of the points near it.
double place_of_first(const SeenAlongAxis& seen) {
  constexpr double near = 0.005;  // share of the object
  const double reach = near * std::abs(seen.back().first - seen.front().first);
  std::vector<double> depths;
  for (const auto& [slope, depth] : seen) {
    if (depths.size() >= points_of_place && std::abs(slope - seen.front().first) > reach) break;
    depths.push_back(depth);
  }
  return seen.front().first * median_in_place(depths);
}

/// Extent across the view along an axis, 0 = x, 1 = y.
double extent_across(const std::vector<Eigen::Vector3d>& points_in_cam, int axis) {
  SeenAlongAxis seen;
  for (const Eigen::Vector3d& point : points_in_cam) seen.emplace_back(point[axis] / point.z(), point.z());
  std::ranges::sort(seen, {}, &SeenAlongAxis::value_type::first);
  const double low = place_of_first(seen);
  std::ranges::reverse(seen);
  return place_of_first(seen) - low;
}

/// Depth in the middle of the image; quality.json states the ground sampling distance for the same place. NaN if no
/// point is there.
double middle_depth(const std::vector<Eigen::Vector3d>& points_in_cam, const Pinhole& camera) {
  constexpr double near = 0.01;  // share of the image's larger side
  const Eigen::Vector2d middle(0.5 * camera.size.width, 0.5 * camera.size.height);
  const double reach = near * std::max(camera.size.width, camera.size.height);
  std::vector<std::pair<double, double>> found;  // distance from the middle in pixels, depth
  for (const Eigen::Vector3d& point : points_in_cam) {
    const double distance = point.z() > 0 ? (camera.project(point) - middle).norm() : reach;
    if (distance < reach) found.emplace_back(distance, point.z());
  }
  std::ranges::sort(found);
  std::vector<double> depths;
  for (std::size_t i = 0; i < std::min(points_of_place, found.size()); ++i) depths.push_back(found[i].second);
  return depths.empty() ? std::numeric_limits<double>::quiet_NaN() : median_in_place(depths);
}

bool is_likely(double width_m, double distance_m) {
  return width_m >= smallest_m && width_m <= largest_m && distance_m >= nearest_m && distance_m <= farthest_m;
}

/// Angle of view [degrees] of the whole image that this one is cut from, at least: it reached as far on the other side
/// of the principal point.
double least_uncut_view_deg(const Pinhole& camera) {
  const double half_u = std::max(camera.cx + 0.5, camera.size.width - 0.5 - camera.cx) / camera.fx;
  const double half_v = std::max(camera.cy + 0.5, camera.size.height - 0.5 - camera.cy) / camera.fy;
  return to_degrees(2 * std::atan(std::max(half_u, half_v)));
}

/// Median angle [degrees] by which normals turn if depths are rounded to single precision. A normal's slopes are
/// differences of two depths over two pixels, and the rounding error is uniform over one step.
double turn_by_rounding_deg(double depth, double gsd) {
  const auto rounded = static_cast<float>(depth);
  const double step = std::nextafter(rounded, std::numeric_limits<float>::max()) - rounded;
  const double slope_sigma = step / gsd / std::sqrt(24.0);
  return to_degrees(std::sqrt(2 * std::numbers::ln2) * slope_sigma);
}

/// A unit in which size and distance would be usual, millimeters and meters first.
std::optional<std::string> likelier_unit(double width, double distance, const std::string& unit) {
  for (const char* const name : {"mm", "m", "cm", "um"}) {
    const double meters = length_unit(name).meters;
    if (name != unit && width * meters >= usual_smallest_m && width * meters <= usual_largest_m &&
        distance * meters >= usual_smallest_m && distance * meters <= usual_largest_m)
      return name;
  }
  return std::nullopt;
}

}  // namespace

ObjectSize object_size(const std::vector<Eigen::Vector3d>& points_in_cam, const Pinhole& camera,
                       const std::string& unit) {
  if (points_in_cam.empty()) throw input_error("no point of the prior lies on the object, expected at least one");
  std::vector<double> depths;
  for (const Eigen::Vector3d& point : points_in_cam) depths.push_back(point.z());
  ObjectSize size;
  size.width = extent_across(points_in_cam, 0);
  size.height = extent_across(points_in_cam, 1);
  size.distance = median_in_place(depths);
  const double in_the_middle = middle_depth(points_in_cam, camera);
  size.gsd = (std::isnan(in_the_middle) ? size.distance : in_the_middle) / camera.focal();

  const double meters = length_unit(unit).meters, larger = std::max(size.width, size.height);
  Finding& finding = size.finding;
  finding.check = Check::size;
  finding.message = "the object is " + in_words(size.width * meters) + " wide and " + in_words(size.height * meters) +
                    " high, " + in_words(size.distance * meters) + " from the camera; one pixel is " +
                    in_words(size.gsd * meters);
  finding.figures = {{"width", size.width}, {"height", size.height}, {"distance", size.distance}, {"gsd", size.gsd}};
  const double view_deg = to_degrees(2 * std::atan(0.5 * camera.size.width / camera.fx));
  if (!is_likely(larger * meters, size.distance * meters)) {
    finding.severity = Severity::warning;
    const auto other = likelier_unit(larger, size.distance, unit);
    finding.message += ": that is unlikely";
    finding.suggestion = other ? "is unit = \"" + *other + "\" meant instead of \"" + unit + "\"?"
                               : "are the units of cloud and camera right?";
  } else if (least_uncut_view_deg(camera) < narrowest_deg || view_deg > widest_deg) {
    finding.severity = Severity::warning;
    finding.message +=
        ": that is seen at an angle of view of " + with_digits(view_deg, 3) + "°, which no usual lens has";
    finding.suggestion = "is the focal length of [camera] in pixels of these images?";
  } else if (const double turn_deg = turn_by_rounding_deg(size.distance, size.gsd); turn_deg > largest_rounding_deg) {
    finding.severity = Severity::caution;
    finding.message += ": with a focal length of " + std::to_string(std::lround(camera.focal())) +
                       " px, depths are rounded so much in single precision that normals turn by " +
                       with_digits(turn_deg, 2) + "°";
    finding.suggestion =
        "can the images be reduced, or [camera] of a telecentric lens be given nearer, with a focal length "
        "shorter by the same factor?";
  }
  return size;
}

}  // namespace malus
