#pragma once

#include <cmath>
#include <random>

#include "malus/core/depth_normals_internal.h"
#include "malus/fusion/fresnel_factors_internal.h"
#include "malus/fusion/reflection_model_internal.h"
#include "malus/fusion/surroundings_internal.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/ray_frame.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// A bumpy surface seen by a camera, its Stokes vectors from the library's own forward model, and a prior
/// without the bumps.
struct SyntheticStation {
  PolarizationState state;
  DepthPrior prior;
  Image<float> truth;
};

struct SyntheticOptions {
  Size size{64, 56};
  Reflection kind = Reflection::diffuse;
  ReflectionModel model;
  double noise = 2e-5;        ///< standard deviation of s1 and s2
  double bump_gsd = 1.5;      ///< height of the bumps that the prior does not have
  double curvature = 0.004;   ///< depth of the bowl, in GSD per px²
  bool flat = false;          ///< a tilted plane with the bumps only
  bool two_finishes = false;  ///< the right third has the model's other finish
};

/// The same for every synthetic station.
inline constexpr double station_focal_px = 900, station_distance_mm = 500;
inline constexpr double station_gsd_mm = station_distance_mm / station_focal_px;

inline SyntheticStation make_station(const SyntheticOptions& options) {
  SyntheticStation station;
  const Size size = options.size;
  station.prior.camera = {size, station_focal_px, station_focal_px, 0.5 * size.width - 3.3, 0.5 * size.height + 2.1};
  station.prior.depth = station.prior.sigma = station.truth = Image<float>(size);
  const double distance = station_distance_mm, gsd = station_gsd_mm;
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      const double x = u - 0.5 * size.width, y = v - 0.5 * size.height;
      const double tilt = 0.45 * x + 0.3 * y;
      const double smooth =
          options.flat ? tilt / (1 - gsd / distance * tilt) : tilt + options.curvature * (x * x + y * y);
      const double bumps = options.bump_gsd * std::sin(0.35 * u) * std::cos(0.3 * v);
      station.truth(u, v) = static_cast<float>(distance + gsd * (smooth + bumps));
      station.prior.depth(u, v) = static_cast<float>(distance + gsd * smooth);
      station.prior.sigma(u, v) = static_cast<float>(0.5 * gsd);
    }
  }
  const Image<float> normals = normals_from_depth(station.truth, station.prior.camera, Context{});
  std::mt19937 random(7);
  std::normal_distribution<double> gauss(0, options.noise);
  PolarizationState& state = station.state;
  state.i_un = state.rho = state.phi = state.residual = Image<float>(size);
  state.valid = Mask(size, 1, 255);
  state.angles_rad = {0, 0.5236, 1.0472, 1.5708, 2.0944, 2.618};
  state.exposures.assign(6, 1);
  state.noise.full_well_e = 1 / (options.noise * options.noise);
  state.noise.read_noise_e = 0;
  for (int v = 0; v < size.height; ++v) {
    for (int u = 0; u < size.width; ++u) {
      const RayFrame frame = ray_frame(&station.prior.camera, u, v);
      const Eigen::Vector3d n(normals(u, v, 0), normals(u, v, 1), normals(u, v, 2));
      const double p = n.dot(frame.right) / n.dot(frame.view), q = n.dot(frame.up) / n.dot(frame.view);
      const MirrorReflection& mirror = options.model.mirror;
      const double s0 = options.kind == Reflection::specular
                            ? mirror.body + mirror.environment * fresnel_factors(p * p + q * q, 1.5).reflectance
                        : options.model.metal_error > 0 ? options.model.mirrored->at(p, q, frame).stokes[0]
                                                        : 0.8 + 0.1 * std::sin(0.05 * u);
      const bool other_finish = options.two_finishes && 3 * u > 2 * size.width;
      const PixelReflection pixel(options.model, options.kind, s0, mirror.body, frame, other_finish);
      const PredictedStokes m = pixel.predict(p, q);
      const double s1 = m.s1 + gauss(random), s2 = m.s2 + gauss(random);
      state.i_un(u, v) = static_cast<float>(s0 / 2);
      state.rho(u, v) = static_cast<float>(std::hypot(s1, s2) / s0);
      state.phi(u, v) = static_cast<float>(0.5 * std::atan2(s2, s1));
    }
  }
  return station;
}

/// RMS depth error about its mean, in GSD, without a border of 4 px.
inline double rms_error_gsd(const Image<float>& depth, const Image<float>& truth, const Pinhole& camera) {
  double sum = 0, squares = 0, count = 0;
  for (int v = 4; v < truth.height() - 4; ++v) {
    for (int u = 4; u < truth.width() - 4; ++u) {
      const double error = (static_cast<double>(depth(u, v)) - truth(u, v)) / (truth(u, v) / camera.focal());
      sum += error;
      squares += error * error;
      ++count;
    }
  }
  return std::sqrt(squares / count - sum * sum / (count * count));
}

}  // namespace malus
