#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "malus/core/degrees_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/lighting/light_from_contour_internal.h"
#include "malus/polarization/ray_frame.h"

namespace malus {
namespace {

/// The outermost pixels mix the object with what is behind it.
constexpr float first_px = 1.5F, least_band_px = 6;
/// Width of the band as a share of the largest distance from the outline.
constexpr double band_share = 0.3;
/// Usable zeniths: where the surface is flatter the phase is noise, where it is steeper the outline half hides it.
constexpr double flattest = to_radians(25), steepest = to_radians(80);
/// Largest angle between a pixel's azimuth and the outward direction, and the smallest share of pixels within it. Of
/// azimuths unrelated to the outline, 28 % are within it.
constexpr double agreement = to_radians(25), least_share = 0.4;
constexpr std::size_t fewest_pixels = 100;

/// Distance of each pixel of the object from its outline [px], zero outside, and a smoothed copy for the gradient.
struct Outline {
  cv::Mat1f distance, smoothed;
};

Outline find_outline(const PolarizationState& state) {
  const Mask object = state.object();
  cv::Mat1b filled(object.height(), object.width(), std::uint8_t{0});
  std::vector<std::vector<cv::Point>> outlines;
  cv::findContours(as_mat(object), outlines, cv::RETR_EXTERNAL, cv::CHAIN_APPROX_NONE);
  cv::drawContours(filled, outlines, -1, cv::Scalar(255), cv::FILLED);
  Outline outline;
  if (cv::countNonZero(filled) == static_cast<int>(filled.total())) return outline;
  cv::distanceTransform(filled, outline.distance, cv::DIST_L2, cv::DIST_MASK_PRECISE);
  cv::GaussianBlur(outline.distance, outline.smoothed, {}, 2, 2, cv::BORDER_REPLICATE);
  return outline;
}

/// The outward one of a pixel's two possible normals, if its azimuth is roughly perpendicular to the outline; else
/// zero.
Eigen::Vector3d outward_normal(const RayFrame& frame, double zenith, double azimuth, const Outline& outline, int u,
                               int v) {
  const cv::Mat1f& field = outline.smoothed;
  // The distance decreases outwards; v points down.
  const double right = field(v, std::max(u - 1, 0)) - field(v, std::min(u + 1, field.cols - 1));
  const double up = field(std::min(v + 1, field.rows - 1), u) - field(std::max(v - 1, 0), u);
  const double along = right * std::cos(azimuth) + up * std::sin(azimuth);
  if (!(std::abs(along) > std::cos(agreement) * std::hypot(right, up))) return Eigen::Vector3d::Zero();
  const double side = along > 0 ? std::tan(zenith) : -std::tan(zenith);
  return frame.normal({side * std::cos(azimuth), side * std::sin(azimuth)});
}

}  // namespace

std::optional<LightEstimate> light_from_contour(const PolarizationState& state, const ReflectionMap& reflection,
                                                const Pinhole* camera, const LightOptions& options,
                                                const Context& context) {
  const OpenCvThreads opencv_threads(context.threads);
  const Outline outline = find_outline(state);
  if (outline.distance.empty()) return std::nullopt;
  double largest = 0;
  cv::minMaxLoc(outline.distance, nullptr, &largest);
  const double band = std::max<double>(least_band_px, band_share * largest);
  Image<float> normals(state.size(), 3, std::numeric_limits<float>::quiet_NaN());
  std::size_t inclined = 0, agreeing = 0;
  for (int v = 0; v < state.size().height; ++v) {
    context.check_cancel();
    for (int u = 0; u < state.size().width; ++u) {
      const double distance = outline.distance(v, u), zenith = reflection.zenith(u, v);
      if (distance < first_px || distance > band || reflection.at(u, v) == Reflection::outside) continue;
      if (!state.is_valid(u, v) || !(zenith > flattest && zenith < steepest)) continue;
      ++inclined;
      const double azimuth = azimuth_of(reflection.at(u, v), state.phi(u, v));
      const Eigen::Vector3d normal = outward_normal(ray_frame(camera, u, v), zenith, azimuth, outline, u, v);
      if (normal.isZero()) continue;
      ++agreeing;
      for (int c = 0; c < 3; ++c) normals(u, v, c) = static_cast<float>(normal[c]);
    }
  }
  if (agreeing < fewest_pixels || static_cast<double>(agreeing) < least_share * static_cast<double>(inclined))
    return std::nullopt;
  // Along the outline ambient light can hardly be separated from directional light.
  LightOptions directional = options;
  directional.model = LightModel::directional;
  LightEstimate light = estimate_light(state.i_un, normals, Mask(state.size(), 1, 255), camera, directional, context);
  if (light.status == LightStatus::normals_alike || light.status == LightStatus::too_few_pixels) return std::nullopt;
  light.of_contour = true;
  return light;
}

}  // namespace malus
