#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

#include "malus/core/dense_systems_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/lighting/light_internal.h"
#include "malus/polarization/ray_frame.h"

namespace malus {
namespace {

struct Sample {
  Eigen::Vector4d basis;
  double intensity;
};

/// Samples per task of a thread.
constexpr std::size_t grain = 4096;

/// Weighted least squares for the coefficients of the basis: the matrix, and the right-hand side as a fifth column.
using NormalEquations = Eigen::Matrix<double, 4, 5>;

NormalEquations normal_equations(const std::vector<Sample>& samples, const std::vector<double>& weights,
                                 const Context& context) {
  const NormalEquations zero = NormalEquations::Zero();
  return parallel_sum(context, samples.size(), grain, zero, [&](std::size_t begin, std::size_t end) {
    NormalEquations sum = zero;
    for (std::size_t i = begin; i < end; ++i) {
      const Eigen::Vector4d weighted = weights[i] * samples[i].basis;
      sum.leftCols<4>() += weighted * samples[i].basis.transpose();
      sum.col(4) += samples[i].intensity * weighted;
    }
    return sum;
  });
}

/// Writes the absolute residuals; returns their weighted root mean square.
double find_residuals(const std::vector<Sample>& samples, const std::vector<double>& weights,
                      const Eigen::Vector4d& coefficients, std::vector<double>& residuals, const Context& context) {
  const Eigen::Array2d sums =
      parallel_sum(context, samples.size(), grain, Eigen::Array2d(0, 0), [&](std::size_t begin, std::size_t end) {
        Eigen::Array2d sum(0, 0);
        for (std::size_t i = begin; i < end; ++i) {
          residuals[i] = std::abs(samples[i].intensity - coefficients.dot(samples[i].basis));
          sum += Eigen::Array2d(weights[i] * residuals[i] * residuals[i], weights[i]);
        }
        return sum;
      });
  return std::sqrt(sums[0] / sums[1]);
}

std::vector<Sample> take_samples(const Image<float>& intensity, const Image<float>& normals, const Mask& mask,
                                 int max_samples, const Context& context) {
  constexpr std::size_t pixels = 1 << 16;  // per task of a thread
  const auto usable = [&](std::size_t i) {
    return mask[i] != 0 && std::isfinite(intensity[i]) && std::isfinite(normals[3 * i]);
  };
  std::vector<std::size_t> before((intensity.count() + pixels - 1) / pixels + 1, 0);  // usable ones before each part
  parallel_for(context, intensity.count(), pixels, [&](std::size_t begin, std::size_t end) {
    std::size_t count = 0;
    for (std::size_t i = begin; i < end; ++i) count += usable(i) ? 1 : 0;
    before[begin / pixels + 1] = count;
  });
  std::partial_sum(before.begin(), before.end(), before.begin());
  const std::size_t stride = before.back() / static_cast<std::size_t>(max_samples) + 1;
  std::vector<Sample> samples((before.back() + stride - 1) / stride);
  parallel_for(context, intensity.count(), pixels, [&](std::size_t begin, std::size_t end) {
    std::size_t next = before[begin / pixels];
    for (std::size_t i = begin; i < end; ++i) {
      if (!usable(i) || next++ % stride != 0) continue;
      samples[(next - 1) / stride] = {{normals[3 * i], normals[3 * i + 1], normals[3 * i + 2], 1}, intensity[i]};
    }
  });
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

void judge_direction(LightEstimate& light, const Pinhole* camera, Size size, const LightOptions& options) {
  light.tangential = tangential_light(light.coefficients.head<3>(), camera, size);
  light.status = light.tangential >= options.min_tangential ? LightStatus::estimated : LightStatus::along_view;
}

double reweigh(const std::vector<double>& residuals, double outlier_scale, std::vector<double>& weights) {
  std::vector<double> sorted = residuals;
  const double sigma = robust_spread(sorted), scale = std::max(outlier_scale * sigma, 1e-12);
  for (std::size_t i = 0; i < residuals.size(); ++i)
    weights[i] = 1 / (1 + residuals[i] * residuals[i] / (scale * scale));
  return sigma;
}

LightEstimate estimate_light(const Image<float>& intensity, const Image<float>& normals, const Mask& mask,
                             const Pinhole* camera, const LightOptions& options, const Context& context) {
  validate_fields(options, "light");
  require_size(normals, intensity.size(), "normals");
  require_size(mask, intensity.size(), "mask");
  if (normals.channels() != 3) throw input_error("normals: expected 3 channels");

  LightEstimate light;
  const std::vector<Sample> samples = take_samples(intensity, normals, mask, options.max_samples, context);
  light.pixels = samples.size();
  const int unknowns = options.model == LightModel::directional ? 3 : 4;
  if (samples.size() < 10u * static_cast<unsigned>(unknowns)) {
    light.status = LightStatus::too_few_pixels;
    return light;
  }

  std::vector<double> residuals(samples.size()), weights(samples.size(), 1.0);
  for (int iteration = 0; iteration < options.iterations; ++iteration) {
    context.check_cancel();
    const NormalEquations equations = normal_equations(samples, weights, context);
    const Eigen::MatrixXd used = equations.topLeftCorner(unknowns, unknowns);
    const Eigen::VectorXd values = symmetric_eigen(used).values;
    const double condition = values[0] > 0 ? values[unknowns - 1] / values[0] : std::numeric_limits<double>::infinity();
    if (!(condition <= options.max_condition)) {
      light.status = LightStatus::normals_alike;
      return light;
    }
    light.coefficients.head(unknowns) = solve_symmetric(used, equations.col(4).head(unknowns));

    light.rms = find_residuals(samples, weights, light.coefficients, residuals, context);
    light.robust_sigma = reweigh(residuals, options.outlier_scale, weights);
  }
  judge_direction(light, camera, intensity.size(), options);
  return light;
}

}  // namespace malus
