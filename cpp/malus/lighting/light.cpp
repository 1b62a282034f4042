#include "malus/lighting/light.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "malus/core/median.h"
#include "malus/polarization/ray_frame.h"

namespace malus {
namespace {

struct Sample {
  Eigen::Vector4d basis;
  double intensity;
};

std::vector<Sample> take_samples(const Image<float>& intensity, const Image<float>& normals, const Mask& mask,
                                 int max_samples) {
  const auto usable = [&](std::size_t i) {
    return mask[i] != 0 && std::isfinite(intensity[i]) && std::isfinite(normals[3 * i]);
  };
  std::size_t count = 0;
  for (std::size_t i = 0; i < intensity.count(); ++i) count += usable(i) ? 1 : 0;
  const std::size_t stride = count / static_cast<std::size_t>(max_samples) + 1;
  std::vector<Sample> samples;
  samples.reserve(count / stride + 1);
  std::size_t next = 0;
  for (std::size_t i = 0; i < intensity.count(); ++i) {
    if (!usable(i) || next++ % stride != 0) continue;
    samples.push_back({{normals[3 * i], normals[3 * i + 1], normals[3 * i + 2], 1}, intensity[i]});
  }
  return samples;
}

}  // namespace

double tangential_light(const Eigen::Vector3d& light, const Pinhole* camera, Size size) {
  constexpr int steps = 8;
  double sum = 0;
  for (int j = 0; j <= steps; ++j) {
    for (int i = 0; i <= steps; ++i) {
      const RayFrame frame = ray_frame(camera, (size.width - 1.0) * i / steps, (size.height - 1.0) * j / steps);
      sum += light.normalized().cross(frame.view).squaredNorm();
    }
  }
  return std::sqrt(sum / ((steps + 1) * (steps + 1)));
}

LightEstimate estimate_light(const Image<float>& intensity, const Image<float>& normals, const Mask& mask,
                             const Pinhole* camera, const LightOptions& options, const Context& context) {
  validate_fields(options, "lighting");
  require_size(normals, intensity.size(), "normals");
  require_size(mask, intensity.size(), "mask");
  if (normals.channels() != 3) throw input_error("normals: expected 3 channels");

  LightEstimate light;
  const std::vector<Sample> samples = take_samples(intensity, normals, mask, options.max_samples);
  light.pixels = samples.size();
  const int unknowns = options.model == LightModel::directional ? 3 : 4;
  if (samples.size() < 10u * static_cast<unsigned>(unknowns)) {
    light.status = LightStatus::too_few_pixels;
    return light;
  }

  std::vector<double> residuals(samples.size()), weights(samples.size(), 1.0);
  for (int iteration = 0; iteration < options.iterations; ++iteration) {
    context.check_cancel();
    Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
    Eigen::Vector4d right = Eigen::Vector4d::Zero();
    for (std::size_t i = 0; i < samples.size(); ++i) {
      normal += weights[i] * samples[i].basis * samples[i].basis.transpose();
      right += weights[i] * samples[i].intensity * samples[i].basis;
    }
    const Eigen::MatrixXd used = normal.topLeftCorner(unknowns, unknowns);
    const Eigen::VectorXd values = Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(used).eigenvalues();
    light.condition = values[0] > 0 ? values[unknowns - 1] / values[0] : std::numeric_limits<double>::infinity();
    if (!(light.condition <= options.max_condition)) {
      light.status = LightStatus::normals_alike;
      return light;
    }
    light.coefficients.head(unknowns) = used.ldlt().solve(right.head(unknowns));

    double weight_sum = 0, square_sum = 0;
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const double residual = samples[i].intensity - light.coefficients.dot(samples[i].basis);
      weight_sum += weights[i];
      square_sum += weights[i] * residual * residual;
      residuals[i] = std::abs(residual);
    }
    light.rms = std::sqrt(square_sum / weight_sum);
    std::vector<double> sorted = residuals;
    light.robust_sigma = 1.4826 * median_in_place(sorted);
    const double scale = std::max(options.outlier_scale * light.robust_sigma, 1e-12);
    for (std::size_t i = 0; i < samples.size(); ++i) {
      weights[i] = 1 / (1 + residuals[i] * residuals[i] / (scale * scale));
    }
  }
  light.tangential = tangential_light(light.coefficients.head<3>(), camera, intensity.size());
  light.status = light.tangential < options.min_tangential ? LightStatus::along_view : LightStatus::estimated;
  return light;
}

}  // namespace malus
