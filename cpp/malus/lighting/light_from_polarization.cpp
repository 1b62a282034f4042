#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "malus/core/robust_spread_internal.h"
#include "malus/lighting/light_from_contour_internal.h"
#include "malus/lighting/light_from_polarization_internal.h"
#include "malus/polarization/ray_frame.h"

namespace malus {
namespace {

/// The two normals of a pixel are along + aside and along − aside.
struct Sample {
  Eigen::Vector3d along, aside;
  double intensity;
  Eigen::Vector2d from_middle;  ///< in the image, x right, y up
};

constexpr std::size_t most_samples = 20'000, fewest_samples = 100;
constexpr int rounds = 30;

std::vector<Sample> take_samples(const PolarizationState& state, const ReflectionMap& reflection,
                                 const Pinhole* camera) {
  const auto usable = [&](int u, int v) { return reflection.at(u, v) != Reflection::outside && state.is_valid(u, v); };
  std::size_t count = 0;
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  for (int v = 0; v < state.size().height; ++v) {
    for (int u = 0; u < state.size().width; ++u) {
      if (!usable(u, v)) continue;
      middle += Eigen::Vector2d(u, -v);
      ++count;
    }
  }
  middle /= static_cast<double>(std::max<std::size_t>(count, 1));
  const std::size_t stride = count / most_samples + 1;
  std::vector<Sample> samples;
  std::size_t next = 0;
  for (int v = 0; v < state.size().height; ++v) {
    for (int u = 0; u < state.size().width; ++u) {
      if (!usable(u, v) || next++ % stride != 0) continue;
      const RayFrame frame = ray_frame(camera, u, v);
      const bool specular = reflection.at(u, v) == Reflection::specular;
      const double azimuth = state.phi(u, v) + (specular ? std::numbers::pi / 2 : 0.0);
      const double zenith = reflection.zenith(u, v);
      samples.push_back({std::cos(zenith) * frame.view,
                         std::sin(zenith) * (std::cos(azimuth) * frame.right + std::sin(azimuth) * frame.up),
                         state.i_un(u, v), Eigen::Vector2d(u, -v) - middle});
    }
  }
  return samples;
}

/// +1 or −1: which of the two normals explains the intensity better.
double likelier_side(const Sample& sample, const Eigen::Vector3d& light) {
  const double difference = (sample.intensity - light.dot(sample.along)) * light.dot(sample.aside);
  return difference < 0 ? -1 : 1;
}

struct Fit {
  Eigen::Vector3d light = Eigen::Vector3d::Zero();
  double rms = std::numeric_limits<double>::infinity();
  double robust_sigma = 0;
};

/// Light and sides in turns from a direction; the direction is kept if it is known.
Fit fit_from(const std::vector<Sample>& samples, const Eigen::Vector3d& direction, bool is_known,
             double outlier_scale) {
  double mean = 0;
  for (const Sample& sample : samples) mean += sample.intensity / static_cast<double>(samples.size());
  Fit fit;
  fit.light = mean / std::max(-direction.z(), 0.2) * direction;
  std::vector<double> residuals(samples.size()), weights(samples.size(), 1.0);
  for (int round = 0; round < rounds; ++round) {
    Eigen::Matrix3d matrix = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const Eigen::Vector3d normal = samples[i].along + likelier_side(samples[i], fit.light) * samples[i].aside;
      matrix += weights[i] * normal * normal.transpose();
      right += weights[i] * samples[i].intensity * normal;
    }
    fit.light = is_known ? Eigen::Vector3d(right.dot(direction) / direction.dot(matrix * direction) * direction)
                         : Eigen::Vector3d(matrix.ldlt().solve(right));
    double squares = 0, sum = 0;
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const Sample& s = samples[i];
      residuals[i] = std::abs(s.intensity - fit.light.dot(s.along + likelier_side(s, fit.light) * s.aside));
      squares += weights[i] * residuals[i] * residuals[i];
      sum += weights[i];
    }
    fit.rms = std::sqrt(squares / sum);
    std::vector<double> sorted = residuals;
    fit.robust_sigma = robust_spread(sorted);
    const double scale = std::max(outlier_scale * fit.robust_sigma, 1e-12);
    for (std::size_t i = 0; i < samples.size(); ++i)
      weights[i] = 1 / (1 + residuals[i] * residuals[i] / (scale * scale));
  }
  return fit;
}

/// How much the normals point away from the middle of the object.
double convexity(const std::vector<Sample>& samples, const Eigen::Vector3d& light) {
  double sum = 0;
  for (const Sample& s : samples) {
    const Eigen::Vector3d normal = likelier_side(s, light) * s.aside;
    sum += normal.x() * s.from_middle.x() - normal.y() * s.from_middle.y();  // the camera's y points down
  }
  return sum;
}

}  // namespace

LightEstimate light_from_polarization(const PolarizationState& state, const ReflectionMap& reflection,
                                      const std::optional<Eigen::Vector3d>& direction, const Pinhole* camera,
                                      const LightOptions& options, const Context& context) {
  validate_fields(options, "light");
  require_size(reflection.zenith, state.size(), "zenith");
  if (!direction && options.without_prior == LightWithoutPrior::contour) {
    if (const auto found = light_from_contour(state, reflection, camera, options, context)) return *found;
  }
  LightEstimate light;
  const std::vector<Sample> samples = take_samples(state, reflection, camera);
  light.pixels = samples.size();
  if (samples.size() < fewest_samples) {
    light.status = LightStatus::too_few_pixels;
    return light;
  }
  Fit best;
  if (direction) {
    best = fit_from(samples, direction->normalized(), true, options.outlier_scale);
  } else {
    for (const double tilt_deg : {20.0, 50.0}) {
      for (int turn = 0; turn < 8; ++turn) {
        context.check_cancel();
        const double tilt = tilt_deg * std::numbers::pi / 180, azimuth = turn * std::numbers::pi / 4;
        const Eigen::Vector3d start(std::sin(tilt) * std::cos(azimuth), -std::sin(tilt) * std::sin(azimuth),
                                    -std::cos(tilt));
        const Fit fit = fit_from(samples, start, false, options.outlier_scale);
        if (fit.robust_sigma < best.robust_sigma || !std::isfinite(best.rms)) best = fit;
      }
    }
    if (convexity(samples, best.light) < 0) best.light.head<2>() *= -1;
  }
  light.coefficients.head<3>() = best.light;
  light.rms = best.rms;
  light.robust_sigma = best.robust_sigma;
  light.tangential = tangential_light(best.light, camera, state.size());
  light.status = light.tangential < options.min_tangential ? LightStatus::along_view : LightStatus::estimated;
  return light;
}

}  // namespace malus
