#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "malus/core/degrees_internal.h"
#include "malus/lighting/light_from_contour_internal.h"
#include "malus/lighting/light_from_polarization_internal.h"
#include "malus/polarization/ray_frame.h"

namespace malus {
namespace {

/// The two normals of a pixel are along + aside and along − aside.
struct PixelSample {
  Eigen::Vector3d along, aside;
  double intensity;
  Eigen::Vector2d from_middle;  ///< in the image, x right, y up
};

constexpr std::size_t most_samples = 20'000, fewest_samples = 100;
constexpr int rounds = 30;
/// Up to this angle between them, the light from all pixels is the outline's light, only more precise.
constexpr double same_light = to_radians(10);

std::vector<PixelSample> take_samples(const PolarizationState& state, const ReflectionMap& reflection,
                                      const Pinhole* camera) {
  const auto usable = [&](int u, int v) { return reflection.at(u, v) != Reflection::outside && state.is_valid(u, v); };
  std::size_t count = 0;
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  for_each_pixel(state.size(), [&](int u, int v) {
    if (!usable(u, v)) return;
    middle += Eigen::Vector2d(u, -v);
    ++count;
  });
  middle /= static_cast<double>(std::max<std::size_t>(count, 1));
  const std::size_t stride = count / most_samples + 1;
  std::vector<PixelSample> samples;
  std::size_t next = 0;
  for_each_pixel(state.size(), [&](int u, int v) {
    if (!usable(u, v) || next++ % stride != 0) return;
    const RayFrame frame = ray_frame(camera, u, v);
    const double azimuth = azimuth_of(reflection.at(u, v), state.phi(u, v));
    const double zenith = reflection.zenith(u, v);
    samples.push_back({std::cos(zenith) * frame.view,
                       std::sin(zenith) * (std::cos(azimuth) * frame.right + std::sin(azimuth) * frame.up),
                       state.i_un(u, v), Eigen::Vector2d(u, -v) - middle});
  });
  return samples;
}

/// +1 or −1: which of the two normals explains the intensity better.
double likelier_side(const PixelSample& sample, const Eigen::Vector3d& light) {
  const double difference = (sample.intensity - light.dot(sample.along)) * light.dot(sample.aside);
  return difference < 0 ? -1 : 1;
}

struct Fit {
  Eigen::Vector3d light = Eigen::Vector3d::Zero();
  double rms = std::numeric_limits<double>::infinity();
  double robust_sigma = 0;
};

/// Expectation of the side, −1 … 1, for normally distributed residuals. Where the intensities of the two normals differ
/// by less than the residuals, the likelier side is a guess. Taking always the better fit would bias the light.
double expected_side(const PixelSample& sample, const Fit& fit) {
  if (fit.robust_sigma == 0) return likelier_side(sample, fit.light);
  const double product = (sample.intensity - fit.light.dot(sample.along)) * fit.light.dot(sample.aside);
  return std::tanh(product / (fit.robust_sigma * fit.robust_sigma));
}

/// Estimates light and sides alternately, starting from a direction; a known direction stays fixed.
Fit fit_from(const std::vector<PixelSample>& samples, const Eigen::Vector3d& direction, bool is_known,
             double outlier_scale) {
  double mean = 0;
  for (const PixelSample& sample : samples) mean += sample.intensity / static_cast<double>(samples.size());
  Fit fit;
  fit.light = mean / std::max(-direction.z(), 0.2) * direction;
  std::vector<double> residuals(samples.size()), weights(samples.size(), 1.0);
  for (int round = 0; round < rounds; ++round) {
    Eigen::Matrix3d matrix = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const PixelSample& s = samples[i];
      const double side = expected_side(s, fit);
      // Means over both sides of normal · normalᵀ and of the normal.
      const Eigen::Matrix3d mixed = side * (s.along * s.aside.transpose() + s.aside * s.along.transpose());
      matrix += weights[i] * (s.along * s.along.transpose() + s.aside * s.aside.transpose() + mixed);
      right += weights[i] * s.intensity * (s.along + side * s.aside);
    }
    fit.light = is_known ? Eigen::Vector3d(right.dot(direction) / direction.dot(matrix * direction) * direction)
                         : Eigen::Vector3d(matrix.ldlt().solve(right));
    double squares = 0, sum = 0;
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const PixelSample& s = samples[i];
      residuals[i] = std::abs(s.intensity - fit.light.dot(s.along + likelier_side(s, fit.light) * s.aside));
      squares += weights[i] * residuals[i] * residuals[i];
      sum += weights[i];
    }
    fit.rms = std::sqrt(squares / sum);
    fit.robust_sigma = reweigh(residuals, outlier_scale, weights);
  }
  return fit;
}

/// Positive if the normals point away from the middle of the object on average.
double convexity(const std::vector<PixelSample>& samples, const Eigen::Vector3d& light) {
  double sum = 0;
  for (const PixelSample& s : samples) {
    const Eigen::Vector3d normal = likelier_side(s, light) * s.aside;
    sum += normal.x() * s.from_middle.x() - normal.y() * s.from_middle.y();  // the camera's y points down
  }
  return sum;
}

/// The best light of several starts. Its side is arbitrary: turned by 180° about the view, it fits the images equally
/// well.
Fit fit_of_unknown_direction(const std::vector<PixelSample>& samples, double outlier_scale, const Context& context) {
  Fit best;
  for (const double tilt_deg : {20.0, 50.0}) {
    for (int turn = 0; turn < 8; ++turn) {
      context.check_cancel();
      const double tilt = to_radians(tilt_deg), azimuth = turn * std::numbers::pi / 4;
      const Eigen::Vector3d start(std::sin(tilt) * std::cos(azimuth), -std::sin(tilt) * std::sin(azimuth),
                                  -std::cos(tilt));
      const Fit fit = fit_from(samples, start, false, outlier_scale);
      if (fit.robust_sigma < best.robust_sigma || !std::isfinite(best.rms)) best = fit;
    }
  }
  return best;
}

}  // namespace

LightEstimate light_from_polarization(const PolarizationState& state, const ReflectionMap& reflection,
                                      const std::optional<Eigen::Vector3d>& direction, const Pinhole* camera,
                                      const LightOptions& options, const Context& context) {
  validate_fields(options, "light");
  require_size(reflection.zenith, state.size(), "zenith");
  std::optional<LightEstimate> of_outline;
  if (!direction && options.without_prior == LightWithoutPrior::contour)
    of_outline = light_from_contour(state, reflection, camera, options, context);
  LightEstimate light;
  const std::vector<PixelSample> samples = take_samples(state, reflection, camera);
  light.pixels = samples.size();
  if (samples.size() < fewest_samples) {
    light.status = LightStatus::too_few_pixels;
    return light;
  }
  const Fit best = direction ? fit_from(samples, direction->normalized(), true, options.outlier_scale)
                             : fit_of_unknown_direction(samples, options.outlier_scale, context);
  Eigen::Vector3d found = best.light;
  if (of_outline) {
    const Eigen::Vector3d outline = of_outline->coefficients.head<3>();
    if (found.head<2>().dot(outline.head<2>()) < 0) found.head<2>() *= -1;
    if (found.dot(outline) < std::cos(same_light) * found.norm() * outline.norm()) return *of_outline;
    light.of_contour = true;
  } else if (!direction && convexity(samples, found) < 0) {
    found.head<2>() *= -1;
  }
  light.coefficients.head<3>() = found;
  light.rms = best.rms;
  light.robust_sigma = best.robust_sigma;
  judge_direction(light, camera, state.size(), options);
  return light;
}

}  // namespace malus
