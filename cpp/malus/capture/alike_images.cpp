#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <numeric>

#include "malus/capture/alike_images_internal.h"
#include "malus/core/digits_internal.h"
#include "malus/core/error.h"
#include "malus/polarization/polarizer_fit_internal.h"

namespace malus {
namespace {

/// Neither a shutter's error nor a reflection changes the exposure by this factor.
constexpr double other_exposure = 1.5;
/// Largest RMS residual of the other images from the sinusoid, as a share of their brightness, at which they count as
/// consistent.
constexpr double alike_share = 0.05;
/// Smallest number of other images: three for the sinusoid's unknowns, and one to check that they are consistent.
constexpr std::size_t least_others = 4;
/// Squared residuals over squared values up to which images count as computed ones without noise; camera noise is at
/// least ten times this.
constexpr double computed = 1e-6;
constexpr std::size_t sampled_pixels = 10000;

bool is_same_angle(double a_rad, double b_rad) {
  return std::abs(std::sin(a_rad - b_rad)) < 1e-6;
}

double mean_of(const Image<float>& image) {
  return std::accumulate(image.begin(), image.end(), 0.0) / static_cast<double>(image.count());
}

/// Brightness of image k over that of the sinusoid through the other images; 1 if the other images are not consistent.
double brightness_beside_others(std::size_t k, const std::vector<double>& means,
                                const std::vector<double>& angles_rad) {
  const auto others = static_cast<double>(means.size() - 1);
  const Eigen::MatrixX3d all = polarizer_rows(angles_rad);
  Eigen::MatrixX3d rows = all;
  Eigen::VectorXd values = Eigen::Map<const Eigen::VectorXd>(means.data(), all.rows());
  const auto left_out = static_cast<Eigen::Index>(k);
  rows.row(left_out).setZero();
  values[left_out] = 0;
  const Eigen::ColPivHouseholderQR<Eigen::MatrixX3d> factors(rows);
  if (factors.rank() < 3) return 1;
  const Eigen::Vector3d stokes = factors.solve(values);
  const double left = (values - rows * stokes).norm() / std::sqrt(others - 3), usual = values.sum() / others;
  const double expected = all.row(left_out) * stokes;
  return left < alike_share * usual && expected > alike_share * usual ? means[k] / expected : 1;
}

/// Whether the images are computed ones without noise, of which two may well be equal.
bool follow_sinusoid(const std::vector<Image<float>>& images, const std::vector<double>& angles_rad) {
  const Eigen::MatrixX3d rows = polarizer_rows(angles_rad);
  const Eigen::ColPivHouseholderQR<Eigen::MatrixX3d> factors(rows);
  double left = 0, all = 0;
  Eigen::VectorXd values(rows.rows());
  for (std::size_t i = 0; i < images[0].count(); i += images[0].count() / sampled_pixels + 1) {
    for (Eigen::Index k = 0; k < rows.rows(); ++k) values[k] = images[static_cast<std::size_t>(k)][i];
    left += (values - rows * factors.solve(values)).squaredNorm();
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
    throw input_error(names[k] + " is " + with_digits(ratio, 2) +
                      " times as bright as the other images and the polarizer's angles let it be, expected one "
                      "exposure and one light for all images ([polarized] exposure_s states exposures that differ on "
                      "purpose)");
  }
}

}  // namespace malus
