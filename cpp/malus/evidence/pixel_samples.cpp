#include <Eigen/QR>
#include <algorithm>
#include <cmath>

#include "malus/evidence/pixel_samples_internal.h"
#include "malus/polarization/polarizer_fit_internal.h"

namespace malus {
namespace {

constexpr double most_samples = 200000;
constexpr float darkest = 0.02F, brightest = 0.9F;

}  // namespace

Eigen::Matrix3Xd stokes_of_intensities(const std::vector<double>& angles_rad) {
  const Eigen::MatrixXd rows = polarizer_rows(angles_rad, std::vector<double>(angles_rad.size(), 1.0));
  return rows.completeOrthogonalDecomposition().pseudoInverse();
}

Eigen::MatrixXd residual_projection(const std::vector<double>& angles_rad) {
  const std::vector<double> gains(angles_rad.size(), 1.0);
  const auto count = static_cast<Eigen::Index>(angles_rad.size());
  return Eigen::MatrixXd::Identity(count, count) -
         polarizer_rows(angles_rad, gains) * stokes_of_intensities(angles_rad);
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
