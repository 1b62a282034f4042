#include <algorithm>
#include <array>
#include <cmath>

#include "malus/object/view_lookup_internal.h"

namespace malus {
namespace {

/// A view sees a place within so many standard deviations of its surface, or so many pixels if that is more.
constexpr double most_off = 4;

struct PixelOfPoint {
  int u, v;
  double depth;
};

std::optional<PixelOfPoint> pixel_of(const ObjectView& view, const Eigen::Vector3d& point) {
  const Eigen::Vector3d at = projected(view, point);
  const Size size = view.camera.size;
  const bool inside =
      at.z() > 0 && at.x() > -0.5 && at.y() > -0.5 && at.x() < size.width - 0.5 && at.y() < size.height - 0.5;
  if (!inside) return {};
  return PixelOfPoint{static_cast<int>(std::rint(at.x())), static_cast<int>(std::rint(at.y())), at.z()};
}

}  // namespace

Eigen::Vector3d point_at(const ObjectView& view, int u, int v) {
  return view.pose.world_from_cam(static_cast<double>(view.depth(u, v)) * view.camera.ray(u, v));
}

Eigen::Vector3d normal_at(const ObjectView& view, int u, int v) {
  return Eigen::Map<const Eigen::Vector3f>(&view.normals(u, v)).cast<double>();
}

Eigen::Vector3d projected(const ObjectView& view, const Eigen::Vector3d& point) {
  const Eigen::Vector3d in_cam = view.pose.cam_from_world(point);
  const Eigen::Vector2d pixel = view.camera.project(in_cam);
  return {pixel.x(), pixel.y(), in_cam.z()};
}

bool may_see(const ObjectView& view, const Eigen::AlignedBox3d& box) {
  if (box.isEmpty()) return false;
  const Pinhole& camera = view.camera;
  // The box is outside if all its corners lie beyond one of the planes that bound the field of view.
  std::array<bool, 5> beyond;
  beyond.fill(true);
  for (int k = 0; k < 8; ++k) {
    const auto corner = box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(k));
    const Eigen::Vector3d at = view.pose.cam_from_world(corner);
    const double z = at.z(), u = camera.fx * at.x() + camera.cx * z, v = camera.fy * at.y() + camera.cy * z;
    const std::array<bool, 5> here{z <= 0, u<-z, v<-z, u> camera.size.width * z, v> camera.size.height * z};
    for (std::size_t side = 0; side < here.size(); ++side) beyond[side] = beyond[side] && here[side];
  }
  return std::ranges::none_of(beyond, [](bool all) { return all; });
}

std::optional<Meeting> meet(const ObjectView& view, const Eigen::Vector3d& point) {
  const auto pixel = pixel_of(view, point);
  if (!pixel || view.usable(pixel->u, pixel->v) == 0) return {};
  const int u = pixel->u, v = pixel->v;
  return Meeting{u, v, pixel->depth, point_at(view, u, v), normal_at(view, u, v), view.sigma(u, v), view.cosine(u, v)};
}

double facing(const ObjectView& view, const Eigen::Vector3d& point, const Eigen::Vector3d& normal) {
  const Eigen::Vector3d to_eye = view.pose.center() - point;
  return normal.dot(to_eye) / to_eye.norm();
}

Placed placed(const ObjectView& view, const Eigen::Vector3d& point) {
  const auto pixel = pixel_of(view, point);
  if (!pixel) return Placed::outside;
  return view.object(pixel->u, pixel->v) != 0 ? Placed::on_object : Placed::beside_object;
}

bool in_front(const ObjectView& view, const Meeting& at, double margin) {
  const double gap = view.depth(at.u, at.v) - at.depth;
  return gap > margin * std::hypot(at.sigma, view.gsd) / std::max(at.weight, least_cosine);
}

bool resolves_more(const ObjectView& view, const ObjectView& other) {
  return other.gsd > alike * view.gsd && view.usual_sigma <= alike * other.usual_sigma;
}

bool is_finer(const ObjectView& view, double cosine, const ObjectView& other, double other_cosine) {
  return resolves_more(view, other) && other.gsd * cosine > alike * view.gsd * other_cosine;
}

std::optional<Sight> sight(const ObjectView& view, const Eigen::Vector3d& point, const Eigen::Vector3d& normal) {
  const double cosine = facing(view, point, normal);
  if (!(cosine > least_cosine)) return {};
  const auto at = meet(view, point);
  if (!at || !(std::abs(at->off(point)) < most_off * std::hypot(at->sigma, view.gsd))) return {};
  return Sight{at->u, at->v, cosine};
}

}  // namespace malus
