#include <algorithm>
#include <array>
#include <cmath>

#include "malus/evidence/pixel_samples_internal.h"
#include "malus/evidence/response_check_internal.h"
#include "malus/polarization/polarizer_fit_internal.h"

namespace malus {
namespace {

constexpr double bend_of_encoded = -0.30, bend_of_decoded = 0.136;
/// With a larger `bend_sigma` than `largest_sigma`, noise of the phases bends the sinusoid, too: of 325 rendered
/// stations, no linear one gives a warning with 0.02.
constexpr double largest_sigma = 0.02, certain_sigmas = 4;
constexpr double least_polarized = 0.02;
/// A residual above this share of the intensity does not come from a response curve.
constexpr double largest_residual = 0.1;

/// Share of the second harmonics outside of all sinusoids that is more than rounding.
constexpr double least_outside = 1e-6;

/// Whether a response curve takes intensities off the sinusoid at all. Through three angles a sinusoid always passes,
/// and a ratio of the rounding errors that are left would be taken for a bend.
bool can_be_bent(const std::vector<double>& angles_rad) {
  Eigen::MatrixX2d harmonics(static_cast<Eigen::Index>(angles_rad.size()), 2);
  for (std::size_t k = 0; k < angles_rad.size(); ++k) {
    harmonics.row(static_cast<Eigen::Index>(k)) << std::cos(4 * angles_rad[k]), std::sin(4 * angles_rad[k]);
  }
  return (residual_projection(polarizer_rows(angles_rad)) * harmonics).norm() > least_outside * harmonics.norm();
}

struct Sums {
  double product = 0, square = 0;
};

/// Σ r · h and Σ h · h by parts of the image, with residuals r and second harmonics h, each pixel divided by its
/// intensity.
std::array<Sums, PixelSamples::part_count> sums_of(const PixelSamples& samples, const std::vector<double>& angles_rad,
                                                   const Context& context) {
  const Eigen::MatrixX3d rows = polarizer_rows(angles_rad);
  const Eigen::MatrixXd projection = residual_projection(rows);
  const Eigen::Matrix3Xd inverse = stokes_of_intensities(rows);
  std::array<Sums, PixelSamples::part_count> sums;
  Eigen::VectorXd bent(static_cast<Eigen::Index>(angles_rad.size()));
  for (std::size_t i = 0; i < samples.values.size(); ++i) {
    if (i % PixelSamples::between_checks == 0) context.check_cancel();
    const Eigen::Vector3d stokes = inverse * samples.values[i];
    const double intensity = stokes[0] / 2, degree = std::hypot(stokes[1], stokes[2]) / stokes[0];
    if (!(degree > least_polarized)) continue;
    const Eigen::VectorXd residual = projection * samples.values[i];
    if (residual.cwiseAbs().maxCoeff() > largest_residual * intensity) continue;
    const double twice_phase = std::atan2(stokes[2], stokes[1]);
    for (Eigen::Index k = 0; k < bent.size(); ++k) {
      bent[k] = intensity * degree * degree * std::cos(2 * (2 * angles_rad[static_cast<std::size_t>(k)] - twice_phase));
    }
    bent = projection * bent;
    Sums& part = sums[static_cast<std::size_t>(samples.parts[i])];
    part.product += residual.dot(bent) / intensity;
    part.square += bent.squaredNorm() / intensity;
  }
  return sums;
}

}  // namespace

ResponseCheck check_response(const std::vector<Image<float>>& images, const std::vector<double>& angles_rad,
                             const Mask& mask, const Response& response, const Context& context) {
  const PixelSamples samples = pixel_samples(images, angles_rad, mask, 0, context);
  ResponseCheck result;
  Finding& finding = result.finding;
  finding.check = Check::response;
  if (!can_be_bent(angles_rad)) {
    finding.message = "whether the images are linear could not be checked: expected four different angles or more";
    return result;
  }
  const auto parts = sums_of(samples, angles_rad, context);
  Sums all;
  for (const Sums& part : parts) {
    all.product += part.product;
    all.square += part.square;
  }
  finding.message =
      "whether the images are linear could not be checked: there is too little polarization for it, or the object "
      "is small in the image";
  if (!(all.square > 0)) return result;
  result.bend = all.product / all.square;
  double count = 0, squares = 0;
  for (const Sums& part : parts) {
    const double rest = all.square - part.square;
    if (!(part.square > 0 && rest > 1e-9 * all.square)) continue;
    squares += std::pow((all.product - part.product) / rest - result.bend, 2);
    ++count;
  }
  if (count < 4) return result;
  result.bend_sigma = std::sqrt((count - 1) / count * squares);
  finding.figures = {{"bend", result.bend}, {"bend_sigma", result.bend_sigma}};
  if (result.bend_sigma > largest_sigma) return result;
  const bool certain = std::abs(result.bend) > certain_sigmas * result.bend_sigma;
  if (certain && result.bend < bend_of_encoded / 2) {
    finding.severity = Severity::warning;
    finding.message =
        "the images look encoded for a display, but response = \"" + response.text() + "\" takes them as linear";
    finding.suggestion = "is response = \"srgb\" right, or can the camera's raw files be developed linearly?";
  } else if (certain && result.bend > bend_of_decoded / 2 && response.is_identity()) {
    // No curve was applied that could have bent the sinusoid: the cause is another, and no other response corrects it.
    finding.message =
        "whether the images are linear could not be checked: the sinusoid is bent, but not as by a response curve; "
        "images that moved, or light that changed, do that";
    finding.figures = {{"bend_of_something_else", result.bend}};
  } else if (certain && result.bend > bend_of_decoded / 2) {
    finding.severity = Severity::warning;
    finding.message = "the images look linear in the file, but response = \"" + response.text() + "\" decodes them";
    finding.suggestion = "is response = \"linear\" right?";
  } else {
    finding.message = "the images are linear in the light, as far as the sinusoid tells";
  }
  return result;
}

Finding response_finding(const Finding& as_read, const Finding& fitted) {
  if (as_read.severity == fitted.severity) return fitted;
  Finding finding;
  finding.check = Check::response;
  finding.message =
      "whether the images are linear could not be checked: what bends the sinusoid is a response curve or wrong "
      "angles";
  const auto bend_of = [](const Finding& of) { return of.figures.empty() ? 0.0 : of.figures.front().second; };
  finding.figures = {{"bend_as_read", bend_of(as_read)}, {"bend_fitted", bend_of(fitted)}};
  return finding;
}

bool says_linear(const Finding& finding) {
  return finding.check == Check::response && finding.severity == Severity::note &&
         std::ranges::any_of(finding.figures, [](const auto& figure) {
           return figure.first == "bend_sigma" && figure.second <= largest_sigma;
         });
}

}  // namespace malus
