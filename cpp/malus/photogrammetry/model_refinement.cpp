#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <opencv2/flann.hpp>
#include <set>
#include <utility>

#include "malus/core/error.h"
#include "malus/core/median_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/photogrammetry/model_refinement_internal.h"
#include "malus/photogrammetry/tie_points_internal.h"

namespace malus {
namespace {

/// Number of neighbors that a point's plane is fitted to, and passes of the fit, which downweight neighbors off the
/// plane.
constexpr int neighbors = 24, plane_passes = 4;
/// Fewest matches that place an image; images with fewer keep their keypoints.
constexpr std::size_t least_matches = 30;
constexpr double least_keypoint_px = 0.1;

/// The model as arrays, by index instead of by id.
struct Arrays {
  std::vector<std::uint32_t> image_ids, camera_ids;
  std::vector<std::uint64_t> point_ids;
  std::map<std::uint32_t, std::size_t> view_of, lens_of;
  std::vector<SweepView> views;
  std::vector<std::vector<TieObservation>> keypoints;  ///< of each point; one per view
};

/// Moves the pictures into the arrays' views.
Arrays arrays_of(const ColmapModel& model, std::map<std::string, Image<float>> pictures) {
  Arrays arrays;
  for (const auto& [id, image] : model.images) {
    const auto picture = pictures.find(image.name);
    if (picture == pictures.end()) throw input_error("the picture of " + image.name + " is missing");
    const LensCamera& camera = model.cameras.at(image.camera_id);
    require_size(picture->second, camera.size, image.name);
    if (arrays.lens_of.emplace(image.camera_id, arrays.camera_ids.size()).second) {
      arrays.camera_ids.push_back(image.camera_id);
    }
    arrays.view_of[id] = arrays.views.size();
    arrays.image_ids.push_back(id);
    arrays.views.push_back({std::move(picture->second), camera, image.pose});
  }
  for (const auto& [id, point] : model.points) {
    std::vector<TieObservation> seen;
    std::set<std::size_t> views;
    for (const auto& [image, keypoint] : point.track) {
      const std::size_t view = arrays.view_of.at(image);
      if (!views.insert(view).second) continue;
      seen.push_back({arrays.point_ids.size(), view, model.images.at(image).keypoints.at(keypoint).pixel, 0});
    }
    if (seen.size() < 2) continue;
    arrays.point_ids.push_back(id);
    arrays.keypoints.push_back(std::move(seen));
  }
  return arrays;
}

/// Robust standard deviation of a keypoint's coordinate.
double keypoint_sigma(const Arrays& arrays, const std::vector<Eigen::Vector3d>& positions) {
  std::vector<double> sizes;
  for (std::size_t k = 0; k < positions.size(); ++k) {
    for (const TieObservation& seen : arrays.keypoints[k]) {
      const SweepView& view = arrays.views[seen.view];
      const Eigen::Vector2d residual = view.camera.project(view.pose.cam_from_world(positions[k])) - seen.pixel;
      sizes.push_back(std::abs(residual.x()));
      sizes.push_back(std::abs(residual.y()));
    }
  }
  return std::max(robust_spread(sizes), least_keypoint_px);
}

/// Normal of the plane through a point's neighbors; neighbors off the plane are downweighted.
Eigen::Vector3d plane_normal(const std::vector<Eigen::Vector3d>& positions, const int* nearest, int count) {
  Eigen::Matrix3Xd around(3, count);
  for (int i = 0; i < count; ++i) around.col(i) = positions[static_cast<std::size_t>(nearest[i])];
  Eigen::VectorXd weights = Eigen::VectorXd::Ones(count);
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  for (int pass = 0; pass < plane_passes; ++pass) {
    const Eigen::Vector3d mean = around * weights / weights.sum();
    const Eigen::Matrix3Xd off = around.colwise() - mean;
    const Eigen::Matrix3d spread = off * weights.asDiagonal() * off.transpose();
    normal = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(spread).eigenvectors().col(0);
    const Eigen::ArrayXd distances = (off.transpose() * normal).array().abs();
    const double middle = median(std::vector<double>(distances.begin(), distances.end()));
    const double scale = std::max(2 * middle, 1e-12 * mean.norm());
    weights = (1 + (distances / scale).square()).inverse().matrix();
  }
  return normal;
}

std::vector<Eigen::Vector3d> plane_normals(const std::vector<Eigen::Vector3d>& positions) {
  const int count = std::min(neighbors, static_cast<int>(positions.size()));
  cv::Mat points(static_cast<int>(positions.size()), 3, CV_32F);
  for (int k = 0; k < points.rows; ++k)
    Eigen::Map<Eigen::Vector3f>(points.ptr<float>(k)) = positions[static_cast<std::size_t>(k)].cast<float>();
  // A single exact tree: several randomized trees would make the result depend on chance.
  cv::flann::GenericIndex<cvflann::L2<float>> tree(points, cvflann::KDTreeSingleIndexParams());
  cv::Mat nearest(points.rows, count, CV_32S), squares(points.rows, count, CV_32F);
  tree.knnSearch(points, nearest, squares, count, cvflann::SearchParams(-1));
  std::vector<Eigen::Vector3d> normals;
  for (int k = 0; k < points.rows; ++k) normals.push_back(plane_normal(positions, nearest.ptr<int>(k), count));
  return normals;
}

/// Points to be matched: points in many images first, until each image has `most` points.
std::vector<std::size_t> points_to_match(const Arrays& arrays, int most) {
  std::vector<std::size_t> order(arrays.keypoints.size()), chosen;
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return arrays.keypoints[a].size() > arrays.keypoints[b].size();
  });
  std::vector<int> taken(arrays.views.size());
  for (const std::size_t point : order) {
    const auto& seen = arrays.keypoints[point];
    if (std::ranges::none_of(seen, [&](const auto& at) { return taken[at.view] < most; })) continue;
    for (const auto& at : seen) ++taken[at.view];
    chosen.push_back(point);
  }
  return chosen;
}

std::size_t reference_of(const Arrays& arrays, std::size_t point, const Eigen::Vector3d& position,
                         const Eigen::Vector3d& normal, std::size_t preferred) {
  std::size_t best = 0;
  double largest = -1;
  for (const TieObservation& seen : arrays.keypoints[point]) {
    if (seen.view == preferred) return preferred;
    const double cosine = std::abs((arrays.views[seen.view].pose.center() - position).normalized().dot(normal));
    if (cosine > largest) {
      largest = cosine;
      best = seen.view;
    }
  }
  return best;
}

/// Removes the observations of views with too few of them for a pose, and of points that no two of the other views see.
/// COLMAP's filter can leave hardly any of an image that was placed by wrong matches.
void leave_out_weak(Bundle& bundle) {
  constexpr int least_of_view = 3, least_of_point = 2;
  for (std::size_t before = 0; before != bundle.observations.size();) {
    before = bundle.observations.size();
    std::vector<int> of_view(bundle.views.size()), of_point(bundle.points.size());
    for (const BundleObservation& seen : bundle.observations) ++of_view[seen.view], ++of_point[seen.point];
    std::erase_if(bundle.observations, [&](const BundleObservation& seen) {
      return of_view[seen.view] < least_of_view || of_point[seen.point] < least_of_point;
    });
  }
}

/// Matches the windows and puts these matches, the keypoints of unmatched points, and those of images with few matches
/// into the bundle. Returns false if there are too few matches: of all but one image, or of the preferred one.
bool measure(const Arrays& arrays, const ColmapModel& model, std::size_t preferred, const PhotosOptions& options,
             Bundle& bundle, ModelRefinement& result, const Context& context) {
  const std::vector<Eigen::Vector3d> normals = plane_normals(bundle.points);
  const std::vector<std::size_t> chosen = points_to_match(arrays, options.match_points_a_photo);
  std::vector<TiePoint> ties;
  for (const std::size_t k : chosen) {
    const Eigen::Vector3d& position = bundle.points[k];
    ties.push_back({position, normals[k], reference_of(arrays, k, position, normals[k], preferred)});
  }
  const std::vector<TieObservation> found = match_tie_points(arrays.views, ties, options, context);
  std::vector<std::size_t> of_view(arrays.views.size());
  for (const TieObservation& seen : found) ++of_view[seen.view];
  const auto is_placed = [&](std::size_t view) { return of_view[view] >= least_matches; };
  for (std::size_t view = 0; view < of_view.size(); ++view) {
    if (!is_placed(view)) result.with_few_matches.push_back(model.images.at(arrays.image_ids[view]).name);
  }
  const bool preferred_is_placed = preferred >= of_view.size() || is_placed(preferred);
  if (!preferred_is_placed || result.with_few_matches.size() + 2 > of_view.size()) return false;

  bundle.observations.clear();
  std::vector<bool> matched(bundle.points.size(), false);
  std::vector<double> sigmas;
  for (const TieObservation& seen : found) {
    const std::size_t point = chosen[seen.point];
    matched[point] = true;
    const bool defines = seen.sigma_px == 0;
    bundle.observations.push_back({seen.view, point, seen.pixel, defines ? options.match_floor_px : seen.sigma_px});
    if (!defines) sigmas.push_back(seen.sigma_px);
  }
  // An image with few matches follows the others by the keypoints of all its points.
  for (std::size_t k = 0; k < matched.size(); ++k) {
    for (const TieObservation& seen : arrays.keypoints[k]) {
      if (!matched[k] || !is_placed(seen.view))
        bundle.observations.push_back({seen.view, k, seen.pixel, result.keypoint_px});
    }
  }
  leave_out_weak(bundle);
  result.points = static_cast<std::size_t>(std::count(matched.begin(), matched.end(), true));
  result.matches = sigmas.size();
  result.matches_a_point =
      static_cast<double>(sigmas.size()) / static_cast<double>(std::max<std::size_t>(result.points, 1));
  result.sigma_px = median(std::move(sigmas));
  return true;
}

void write_back(const Bundle& bundle, const Arrays& arrays, ColmapModel& model) {
  for (std::size_t k = 0; k < arrays.camera_ids.size(); ++k) {
    model.cameras.at(arrays.camera_ids[k]) = bundle.lenses[k].camera;
  }
  for (std::size_t k = 0; k < arrays.image_ids.size(); ++k) {
    model.images.at(arrays.image_ids[k]).pose = bundle.views[k].pose;
  }
  std::vector<double> errors(bundle.points.size()), counts(bundle.points.size());
  for (const BundleObservation& seen : bundle.observations) {
    errors[seen.point] += residual_px(bundle, seen).norm();
    ++counts[seen.point];
  }
  for (std::size_t k = 0; k < arrays.point_ids.size(); ++k) {
    if (counts[k] == 0) continue;
    ColmapPoint& point = model.points.at(arrays.point_ids[k]);
    point.position = bundle.points[k];
    point.error_px = errors[k] / counts[k];
  }
}

}  // namespace

ModelRefinement refine_model(ColmapModel& model, std::map<std::string, Image<float>> pictures,
                             const std::string& preferred, const std::map<std::uint32_t, LensFreedom>& freedom,
                             const PhotosOptions& options, const Context& context) {
  ModelRefinement result;
  const Arrays arrays = arrays_of(model, std::move(pictures));
  std::vector<Eigen::Vector3d> positions;
  for (const std::uint64_t id : arrays.point_ids) positions.push_back(model.points.at(id).position);
  result.status = AdjustmentStatus::too_few_matches;
  if (positions.size() < static_cast<std::size_t>(neighbors)) return result;
  result.keypoint_px = keypoint_sigma(arrays, positions);
  std::size_t preferred_view = arrays.views.size();
  for (const auto& [id, image] : model.images) {
    if (image.name == preferred) preferred_view = arrays.view_of.at(id);
  }

  Bundle bundle;
  for (const std::uint32_t id : arrays.camera_ids) {
    const auto free = freedom.find(id);
    bundle.lenses.push_back({model.cameras.at(id), free == freedom.end() ? LensFreedom::fixed : free->second, {}});
  }
  for (const std::uint32_t id : arrays.image_ids) {
    const ColmapImage& image = model.images.at(id);
    bundle.views.push_back({arrays.lens_of.at(image.camera_id), image.pose});
  }
  bundle.points = positions;
  if (!measure(arrays, model, preferred_view, options, bundle, result, context)) return result;
  result.adjustment = adjust_bundle(bundle, context);
  result.status = result.adjustment.status;
  for (std::size_t k = 0; k < bundle.lenses.size(); ++k) {
    if (!bundle.lenses[k].sigma.empty()) result.lens_sigma[arrays.camera_ids[k]] = bundle.lenses[k].sigma;
  }
  write_back(bundle, arrays, model);
  return result;
}

}  // namespace malus
