// A photogrammetry program that uses Malus as a library: it passes its own points, cameras and images and gets a mesh,
// without reading or writing a file. It is built outside the source tree, against an installed malus.
#include <malus/core/version.h>
#include <malus/object/combine.h>
#include <malus/object/sharpening.h>
#include <malus/station/reconstruct.h>
#include <malus/surface/mesh.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "survey.h"

namespace {

// docs/toolchains.md shows the next two functions.
malus::Results measured(std::vector<malus::Image<float>> images, std::vector<double> angles_deg,
                        const malus::Pinhole& camera, const malus::Pose& pose, malus::PointCloud points) {
  malus::Station station;
  station.file.name = "plate";
  station.file.polarized.angles_deg = std::move(angles_deg);
  const malus::LensCamera lens{malus::LensModel::pinhole, camera.size, {camera.fx, camera.fy, camera.cx, camera.cy}};
  station.file.camera = malus::CameraSpec{lens, pose};
  station.images = std::move(images);  // linear, 1 = white
  station.prior = std::move(points);   // world frame, millimeters

  malus::Context context;
  context.threads = 2;
  context.on_log = [](malus::LogLevel level, const std::string& message) {
    if (level == malus::LogLevel::warning) std::fprintf(stderr, "warning: %s\n", message.c_str());
  };
  return malus::reconstruct(station, malus::Options(), {.until = "fuse"}, context);
}

malus::TriangleMesh mesh_of(const malus::Results& station) {
  const auto surface = station.get<malus::FusedSurface>();
  const auto polarization = station.get<malus::MeasuredPolarization>();
  return malus::mesh_from_depth(*surface, polarization->state->i_un, malus::Options().surface, {});
}

// docs/object.md shows this function.
malus::OrientedPoints points_of_object(const std::vector<malus::Results>& stations, const malus::Context& context) {
  std::vector<std::shared_ptr<const malus::FusedSurface>> surfaces;
  std::vector<malus::ViewMaps> maps;
  std::vector<double> shared_px;
  std::vector<malus::PhaseMaps> phases;
  for (const malus::Results& station : stations) {
    const auto polarization = station.get<malus::CalibratedPolarization>()->state;
    const auto prior = station.get<malus::DepthPrior>();
    surfaces.push_back(station.get<malus::FusedSurface>());
    const double most_sigma_gsd = malus::most_sigma_gsd(malus::median_gsd(*surfaces.back()), prior->noise);
    maps.push_back(malus::view_maps(*surfaces.back(), most_sigma_gsd, context));
    shared_px.push_back(malus::shared_px(prior->smoothing_px));
    phases.push_back(malus::phase_maps(polarization->rho, polarization->phi));
  }
  // Views own no pixels: what they look at must outlive them.
  std::vector<malus::ObjectView> views;
  std::vector<malus::PhasedView> telling;
  for (std::size_t k = 0; k < stations.size(); ++k) {
    views.push_back(malus::object_view("station " + std::to_string(k), *surfaces[k], maps[k], shared_px[k]));
    const malus::PhasedView station{views[k], phases[k].cosine, phases[k].sine};
    if (malus::is_telling(station, context)) telling.push_back(station);
  }
  std::vector<malus::SharpenedMaps> sharp;
  for (const malus::ObjectView& view : views) sharp.push_back(malus::sharpened(view, telling, context));
  for (std::size_t k = 0; k < views.size(); ++k) {
    views[k].depth = sharp[k].depth;
    views[k].normals = sharp[k].normals;
  }
  return malus::object_points(views, {}, context);
}

/// Median angle between the mesh's normals and the true normals, degrees.
double median_error_deg(const malus::TriangleMesh& mesh, const View& view) {
  std::vector<double> angles;
  for (std::size_t i = 0; i < mesh.vertices.points.size(); ++i) {
    const Eigen::Vector2d pixel = view.camera.project(view.pose.cam_from_world(mesh.vertices.points[i]));
    const Eigen::Vector3d normal = view.pose.rotation * mesh.vertices.normals[i].cast<double>();
    const double cosine = normal.dot(true_normal(pixel.x(), pixel.y()));
    angles.push_back(std::acos(std::clamp(cosine, -1.0, 1.0)) * 180 / std::numbers::pi);
  }
  std::nth_element(angles.begin(), angles.begin() + static_cast<std::ptrdiff_t>(angles.size() / 2), angles.end());
  return angles[angles.size() / 2];
}

/// Root mean square of the points' distances from the true surface along the rays of the view.
double depth_error(const std::vector<Eigen::Vector3d>& points, const View& view) {
  double sum = 0;
  for (const Eigen::Vector3d& point : points) {
    const Eigen::Vector3d seen = view.pose.cam_from_world(point);
    const Eigen::Vector2d pixel = view.camera.project(seen);
    const double error = seen.z() - true_depth(pixel.x(), pixel.y());
    sum += error * error;
  }
  return std::sqrt(sum / static_cast<double>(points.size()));
}

/// Whether a station with only two angles is refused with a data error; prints the reason.
bool refuses_two_angles() {
  const View view = polarized_view();
  try {
    measured(polarized_images({0, 90}), {0, 90}, view.camera, view.pose, intersected_points());
    return false;
  } catch (const malus::Error& error) {
    std::printf("two angles: %s\n", error.what());
    return error.code() == malus::ErrorCode::data;
  }
}

}  // namespace

int main() try {
  const View view = polarized_view();
  const std::vector<double> angles_deg{0, 30, 60, 90, 120, 150};
  const malus::PointCloud points = intersected_points();
  const malus::Results station = measured(polarized_images(angles_deg), angles_deg, view.camera, view.pose, points);
  const malus::TriangleMesh mesh = mesh_of(station);
  const double before = depth_error(points.points, view), after = depth_error(mesh.vertices.points, view);
  const double normals = median_error_deg(mesh, view);
  std::printf("malus %s: %zu points, off by %.2f mm; %zu vertices, off by %.2f mm, normals by %.1f degrees\n",
              malus::version, points.points.size(), before, mesh.vertices.points.size(), after, normals);
  const std::vector<Eigen::Vector3d> joined = points_of_object({station}, {}).points;
  std::printf("as an object: %zu points, off by %.2f mm\n", joined.size(), depth_error(joined, view));
  // Nearly every pixel must have a vertex. Normals off by 4 degrees are good: the relief's slopes reach 20 degrees and
  // more.
  const double enough = 0.95 * static_cast<double>(view.camera.size.area());
  const bool good = mesh.vertices.points.size() > enough && after < before && normals < 4 && joined.size() > enough &&
                    depth_error(joined, view) < before;
  return good && refuses_two_angles() ? 0 : 1;
} catch (const malus::Error& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
