#include <Eigen/QR>
#include <algorithm>
#include <cmath>

#include "malus/evidence/pixel_samples_internal.h"

namespace malus {
namespace {

constexpr double most_samples = 200000;
constexpr float darkest = 0.02F, brightest = 0.9F;

}  // namespace

Eigen::MatrixX3d sinusoid_rows(const std::vector<double>& angles_rad) {
  Eigen::MatrixX3d rows(static_cast<Eigen::Index>(angles_rad.size()), 3);
  for (Eigen::Index k = 0; k < rows.rows(); ++k) {
    const double twice = 2 * angles_rad[static_cast<std::size_t>(k)];
    rows.row(k) << 0.5, 0.5 * std::cos(twice), 0.5 * std::sin(twice);
  }
  return rows;
}

Eigen::MatrixXd residual_projection(const std::vector<double>& angles_rad) {
  const Eigen::MatrixXd rows = sinusoid_rows(angles_rad);
  return Eigen::MatrixXd::Identity(rows.rows(), rows.rows()) -
         rows * rows.completeOrthogonalDecomposition().pseudoInverse();
}

PixelSamples pixel_samples(const std::vector<Image<float>>& images, const Mask& mask) {
  PixelSamples samples;
  const Size size = images.front().size();
  const int stride = static_cast<int>(std::sqrt(static_cast<double>(size.area()) / most_samples)) + 1;
  Eigen::VectorXd values(static_cast<Eigen::Index>(images.size()));
  for (int v = 0; v < size.height; v += stride) {
    for (int u = 0; u < size.width; u += stride) {
      if (!mask.empty() && mask(u, v) == 0) continue;
      for (std::size_t k = 0; k < images.size(); ++k) values[static_cast<Eigen::Index>(k)] = images[k](u, v);
      if (!(values.minCoeff() > darkest && values.maxCoeff() < brightest)) continue;
      samples.values.push_back(values);
      samples.parts.push_back(8 * v / size.height * 8 + 8 * u / size.width);
    }
  }
  return samples;
}

}  // namespace malus
