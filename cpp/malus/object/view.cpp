#include "malus/object/view.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/square_internal.h"
#include "malus/object/view_lookup_internal.h"

namespace malus {
namespace {

/// Up to this many pixels from a step in depth or from the contour, pixels mix foreground and background.
constexpr int rim_px = 2;
/// A depth difference of more than this many GSD between neighboring pixels, widened by the slope, is a step.
constexpr double most_step_gsd = 6.0;
/// Usual limit of a surface's sigma, in GSD and in standard deviations of a point of the prior; the larger one counts.
constexpr double usual_limit = 4.0;
/// Errors of depth are alike over this share of the length that the prior was smoothed over (decision 121).
constexpr double shared_part = 0.5;

Eigen::Vector3d normal_in_cam(const FusedSurface& surface, int u, int v) {
  return Eigen::Map<const Eigen::Vector3f>(&surface.normals(u, v)).cast<double>();
}

bool is_known(const FusedSurface& surface, int u, int v) {
  return std::isfinite(surface.depth(u, v)) && std::isfinite(surface.sigma(u, v)) &&
         normal_in_cam(surface, u, v).allFinite();
}

/// Cosine of the angle between normal and viewing ray.
double cosine_at(const FusedSurface& surface, int u, int v) {
  return -normal_in_cam(surface, u, v).dot(surface.camera.ray(u, v).normalized());
}

double gsd_at(const FusedSurface& surface, int u, int v) {
  return surface.depth(u, v) / surface.camera.fx;
}

/// A region and the pixels within rim_px of it.
Mask grown(Mask region, const Context& context) {
  for (int k = 0; k < rim_px; ++k) {
    const Mask before = region;
    parallel_pixels(context, region.size(), [&](int u, int v) {
      const auto is_set = [&](int column, int row) { return before.contains(column, row) && before(column, row) != 0; };
      if (is_set(u - 1, v) || is_set(u + 1, v) || is_set(u, v - 1) || is_set(u, v + 1)) region(u, v) = 1;
    });
  }
  return region;
}

/// Pixels near the contour or a step in depth.
Mask rims(const FusedSurface& surface, const Context& context) {
  const auto largest_step = [&](int u, int v) {
    const double slope2 = 1 / square(std::max(cosine_at(surface, u, v), least_cosine)) - 1;
    return most_step_gsd * gsd_at(surface, u, v) * (1 + std::sqrt(std::max(slope2, 0.0)));
  };
  // A difference from an unknown pixel is NaN, which exceeds no limit.
  const auto is_step = [&](int u, int v, int other_u, int other_v) {
    if (!surface.depth.contains(other_u, other_v)) return false;
    const double step = std::abs(surface.depth(u, v) - surface.depth(other_u, other_v));
    return step > largest_step(u, v) && step > largest_step(other_u, other_v);
  };
  Mask edge(surface.camera.size);
  parallel_pixels(context, edge.size(), [&](int u, int v) {
    edge(u, v) = !is_known(surface, u, v) || is_step(u, v, u - 1, v) || is_step(u, v, u + 1, v) ||
                 is_step(u, v, u, v - 1) || is_step(u, v, u, v + 1);
  });
  return grown(std::move(edge), context);
}

}  // namespace

void ObjectView::validate() const {
  if (!(gsd > 0 && std::isfinite(gsd))) {
    throw input_error(name + ": its GSD is " + std::to_string(gsd) +
                      ", expected a positive number; a surface that is "
                      "known nowhere has none");
  }
  if (!(usual_sigma > 0 && std::isfinite(usual_sigma))) {
    throw input_error(name + ": its usual sigma is " + std::to_string(usual_sigma) + ", expected a positive number");
  }
  if (!(shared_px >= 1 && std::isfinite(shared_px))) {
    throw input_error(name + ": its errors are alike over " + std::to_string(shared_px) +
                      " pixels (shared_px), expected a number of at least 1");
  }
  const auto require = [&](Size size, int channels, int expected, const char* raster) {
    if (size == camera.size && channels == expected) return;
    throw input_error(name + ": " + raster + " is " + to_string(size) + " pixels of " + std::to_string(channels) +
                      " values, expected " + to_string(camera.size) + " of " + std::to_string(expected));
  };
  require(depth.size(), depth.channels(), 1, "depth");
  require(normals.size(), normals.channels(), 3, "normals");
  require(sigma.size(), sigma.channels(), 1, "sigma");
  require(cosine.size(), cosine.channels(), 1, "cosine");
  require(usable.size(), usable.channels(), 1, "usable");
  require(object.size(), object.channels(), 1, "object");
}

ViewMaps view_maps(const FusedSurface& surface, double most_sigma_gsd, const Context& context) {
  const Size size = surface.camera.size;
  require_size(surface.depth, size, "depth");
  require_size(surface.normals, size, "normals");
  require_size(surface.sigma, size, "sigma");
  ViewMaps maps{Image<float>::uninitialized(size, 3), Image<float>::uninitialized(size),
                Image<float>::uninitialized(size), rims(surface, context), Mask(size)};
  const Eigen::Matrix3d to_world = surface.pose.rotation.transpose();
  parallel_pixels(context, size, [&](int u, int v) {
    const double cosine = cosine_at(surface, u, v);
    // An error of depth moves the point along its ray; sigma is needed along the normal.
    const double sigma =
        surface.sigma(u, v) * surface.camera.ray(u, v).norm() * std::min(std::max(cosine, least_cosine), 1.0);
    Eigen::Map<Eigen::Vector3f>(&maps.normals(u, v)) = (to_world * normal_in_cam(surface, u, v)).cast<float>();
    maps.sigma(u, v) = static_cast<float>(sigma);
    maps.cosine(u, v) = static_cast<float>(cosine);
    maps.object(u, v) = is_known(surface, u, v);
    maps.usable(u, v) = maps.object(u, v) != 0 && maps.usable(u, v) == 0 && cosine > least_cosine &&
                        sigma < most_sigma_gsd * gsd_at(surface, u, v);
  });
  maps.object = grown(std::move(maps.object), context);
  return maps;
}

ObjectView object_view(std::string name, const FusedSurface& surface, const ViewMaps& maps, double shared_px) {
  ObjectView view;
  view.name = std::move(name);
  view.camera = surface.camera;
  view.pose = surface.pose;
  view.gsd = view.usual_sigma = median_gsd(surface);
  view.shared_px = shared_px;
  view.depth = surface.depth;
  view.normals = maps.normals;
  view.sigma = maps.sigma;
  view.cosine = maps.cosine;
  view.usable = maps.usable;
  view.object = maps.object;
  view.validate();
  view.usual_sigma = usual_sigma(view);
  return view;
}

double median_gsd(const FusedSurface& surface) {
  std::vector<double> known;
  for_each_pixel(surface.camera.size, [&](int u, int v) {
    if (is_known(surface, u, v)) known.push_back(gsd_at(surface, u, v));
  });
  return percentile_in_place(known, 0.5);
}

double most_sigma_gsd(double gsd, double prior_noise) {
  return usual_limit * std::max(1.0, prior_noise / gsd);
}

double shared_px(double smoothing_px) {
  return std::max(1.0, shared_part * smoothing_px);
}

double usual_sigma(const ObjectView& view) {
  std::vector<double> usable;
  for_each_pixel(view.camera.size, [&](int u, int v) {
    if (view.usable(u, v) != 0) usable.push_back(view.sigma(u, v));
  });
  return usable.empty() ? view.gsd : percentile_in_place(usable, 0.5);
}

}  // namespace malus
