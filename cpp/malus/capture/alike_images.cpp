#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <numeric>
#include <sstream>

#include "malus/capture/alike_images_internal.h"
#include "malus/core/error.h"

namespace malus {
namespace {

/// Another exposure by this factor is no error of a shutter, and no reflection makes it.
constexpr double other_exposure = 1.5;
/// RMS of what the sinusoid leaves of the other images' brightness: they are alike among themselves.
constexpr double alike = 0.05;
/// Images beside the one that is looked at: the sinusoid's three unknowns, and one that shows that they are alike.
constexpr std::size_t least_others = 4;
/// Squared residuals over squared values up to which images follow the sinusoid as computed ones do; noise of cameras
/// is ten times this and more.
constexpr double computed = 1e-6;
constexpr std::size_t sampled_pixels = 10000;

Eigen::RowVector3d wave(double angle_rad) {
  return {1, std::cos(2 * angle_rad), std::sin(2 * angle_rad)};
}

bool is_same_angle(double a_rad, double b_rad) {
  return std::abs(std::sin(a_rad - b_rad)) < 1e-6;
}

double mean_of(const Image<float>& image) {
  return std::accumulate(image.begin(), image.end(), 0.0) / static_cast<double>(image.count());
}

/// Brightness of image k over that of the sinusoid through the others; 1 where these are not alike.
double brightness_beside_others(std::size_t k, const std::vector<double>& means,
                                const std::vector<double>& angles_rad) {
  const auto others = static_cast<Eigen::Index>(means.size() - 1);
  Eigen::MatrixX3d waves(others, 3);
  Eigen::VectorXd values(others);
  Eigen::Index row = 0;
  for (std::size_t j = 0; j < means.size(); ++j) {
    if (j == k) continue;
    waves.row(row) = wave(angles_rad[j]);
    values[row++] = means[j];
  }
  const Eigen::ColPivHouseholderQR<Eigen::MatrixX3d> factors(waves);
  if (factors.rank() < 3) return 1;
  const Eigen::Vector3d fitted = factors.solve(values);
  const double left = (values - waves * fitted).norm() / std::sqrt(static_cast<double>(others - 3));
  const double expected = wave(angles_rad[k]) * fitted;
  return left < alike * values.mean() && expected > alike * values.mean() ? means[k] / expected : 1;
}

/// Whether computed images, without noise, are what these are: two of them may well be the same then.
bool follow_sinusoid(const std::vector<Image<float>>& images, const std::vector<double>& angles_rad) {
  const auto count = static_cast<Eigen::Index>(images.size());
  Eigen::MatrixX3d waves(count, 3);
  for (Eigen::Index k = 0; k < count; ++k) waves.row(k) = wave(angles_rad[static_cast<std::size_t>(k)]);
  const Eigen::ColPivHouseholderQR<Eigen::MatrixX3d> factors(waves);
  double left = 0, all = 0;
  Eigen::VectorXd values(count);
  for (std::size_t i = 0; i < images[0].count(); i += images[0].count() / sampled_pixels + 1) {
    for (Eigen::Index k = 0; k < count; ++k) values[k] = images[static_cast<std::size_t>(k)][i];
    left += (values - waves * factors.solve(values)).squaredNorm();
    all += values.squaredNorm();
  }
  return left <= computed * all;
}

}  // namespace

void require_alike_images(const std::vector<Image<float>>& images, const std::vector<std::string>& names,
                          const std::vector<double>& angles_rad) {
  if (angles_rad.size() != images.size()) return;
  std::vector<double> means;
  std::ranges::transform(images, std::back_inserter(means), mean_of);
  for (std::size_t k = 1; k < images.size(); ++k) {
    for (std::size_t j = 0; j < k; ++j) {
      if (means[j] != means[k] || is_same_angle(angles_rad[j], angles_rad[k])) continue;
      if (std::ranges::equal(images[j], images[k]) && !follow_sinusoid(images, angles_rad))
        throw input_error(names[k] + " has the same pixels as " + names[j] +
                          ", expected an image of its own at every angle of the polarizer");
    }
  }
  if (images.size() <= least_others) return;
  for (std::size_t k = 0; k < images.size(); ++k) {
    const double ratio = brightness_beside_others(k, means, angles_rad);
    if (ratio < other_exposure && ratio > 1 / other_exposure) continue;
    std::ostringstream text;
    text.precision(2);
    text << names[k] << " is " << ratio
         << " times as bright as the other images and the polarizer's angles let it be, expected one exposure and one "
            "light for all images ([polarized] exposure_s states exposures that differ on purpose)";
    throw input_error(text.str());
  }
}

}  // namespace malus
