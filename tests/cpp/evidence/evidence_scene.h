#pragma once

#include <cmath>
#include <functional>
#include <numbers>
#include <random>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/depth_normals_internal.h"
#include "malus/core/geometry.h"
#include "malus/core/pose.h"
#include "malus/evidence/prior_alignment_internal.h"
#include "malus/polarization/fresnel.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/ray_frame.h"

namespace malus {

/// Sum of waves of random directions and lengths in px, RMS 1.
class Waves {
 public:
  Waves(unsigned seed, double shortest_px, double longest_px) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> turn(0, 2 * std::numbers::pi), length(shortest_px, longest_px);
    for (int i = 0; i < count; ++i) {
      const double direction = turn(random), k = 2 * std::numbers::pi / length(random);
      waves_.push_back({k * std::cos(direction), k * std::sin(direction), turn(random)});
    }
  }
  double operator()(double u, double v) const {
    double sum = 0;
    for (const Eigen::Vector3d& wave : waves_) sum += std::sin(wave[0] * u + wave[1] * v + wave[2]);
    return sum / std::sqrt(0.5 * count);
  }

 private:
  static constexpr int count = 40;
  std::vector<Eigen::Vector3d> waves_;
};

/// A textured bumpy oval (or another relief) 100 mm from the camera: the camera's view of it with diffuse polarization,
/// and its point cloud.
struct EvidenceScene {
  Pinhole camera{{300, 220}, 600, 600, 150.3, 108.6};
  Pose pose{Eigen::AngleAxisd(0.7, Eigen::Vector3d(0.2, 0.9, 0.1).normalized()).toRotationMatrix(), {3, -2, 40}};
  Mask object{camera.size};
  Image<float> depth{camera.size}, normals;
  PolarizationState state;
  Image<float> everything;  ///< intensity
  PointCloud cloud;         ///< world frame

  /// Value at a pixel; RMS about 1.
  using Pattern = std::function<double(double u, double v)>;

  explicit EvidenceScene(bool has_texture = true, unsigned seed = 1)
      : EvidenceScene(Waves(seed, 25, 80), has_texture ? Pattern(Waves(seed + 1, 6, 30)) : nullptr) {}

  /// An empty `texture` means no texture and no colors.
  EvidenceScene(const Pattern& bumps, const Pattern& texture) {
    for (int v = 0; v < camera.size.height; ++v) {
      for (int u = 0; u < camera.size.width; ++u) {
        depth(u, v) = static_cast<float>(100 + 0.8 * bumps(u, v));
        object(u, v) = std::hypot((u - 150) / 110.0, (v - 110) / 80.0) < 1 ? 255 : 0;
      }
    }
    normals = normals_from_depth(depth, camera, {});
    state.i_un = state.rho = state.phi = everything = Image<float>(camera.size);
    state.valid = Mask(camera.size);
    state.angles_rad = {0, 1, 2};
    state.exposures = {16, 16, 16};
    for (int v = 0; v < camera.size.height; ++v) {
      for (int u = 0; u < camera.size.width; ++u)
        render(u, v, texture ? 0.4 * std::exp(0.4 * texture(u, v)) : 0.4, texture != nullptr);
    }
  }

  AlignmentScene images() const { return {state, everything, object, camera, "mm"}; }

  /// The cloud moved in the camera frame.
  PointCloud moved(const Eigen::Affine3d& motion) const {
    PointCloud result = cloud;
    for (Eigen::Vector3d& point : result.points) point = pose.world_from_cam(motion * pose.cam_from_world(point));
    for (Eigen::Vector3f& normal : result.normals) {
      const Eigen::Vector3d turned = motion.linear() * pose.rotation * normal.cast<double>();
      normal = (pose.rotation.transpose() * turned).normalized().cast<float>();
    }
    return result;
  }

 private:
  void render(int u, int v, double albedo, bool has_colors) {
    const bool is_object = object(u, v) != 0;
    const Eigen::Vector3d normal(normals(u, v, 0), normals(u, v, 1), normals(u, v, 2));
    const Slopes slopes = ray_frame(camera.ray(u, v)).slopes(normal);
    const double shade = std::max(0.1, normal.dot(Eigen::Vector3d(-0.3, -0.4, -0.86)));
    everything(u, v) = state.i_un(u, v) = static_cast<float>(is_object ? 0.5 * albedo * shade : 0.02);
    state.rho(u, v) = static_cast<float>(diffuse_degree(std::atan(std::sqrt(slopes.tan2())), 1.5));
    const double azimuth = slopes.azimuth_rad();
    state.phi(u, v) = static_cast<float>(azimuth < 0 ? azimuth + std::numbers::pi : azimuth);
    state.valid(u, v) = static_cast<std::uint8_t>(is_object ? PixelState::valid : PixelState::outside);
    if (!is_object || (u + v) % 2 != 0) return;
    cloud.points.push_back(pose.world_from_cam(depth(u, v) * camera.ray(u, v)));
    cloud.normals.push_back((pose.rotation.transpose() * normal).cast<float>());
    if (!has_colors) return;
    // Gamma-encoded as for a display.
    const auto gray = static_cast<std::uint8_t>(std::clamp(255 * std::pow(albedo, 1 / 2.2), 0.0, 255.0));
    cloud.colors.push_back({gray, gray, gray});
  }
};

}  // namespace malus
