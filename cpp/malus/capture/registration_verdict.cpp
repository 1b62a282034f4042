#include <algorithm>
#include <cmath>
#include <sstream>

#include "malus/capture/registration_verdict_internal.h"
#include "malus/core/digits_internal.h"

namespace malus {
namespace {

/// Moves are wrong if the moved images have less than this share of the texture in common that the unmoved ones have.
constexpr double least_kept_texture = 0.5;
/// Least regression of an image's band on the others' that still counts as the same scene.
constexpr double least_similarity = 0.25;

}  // namespace

void judge_registration(ImageRegistration& result, const RegistrationFigures& figures, Size size,
                        const RegistrationOptions& options) {
  std::ostringstream message;
  message.precision(3);
  const double linear = (result.image_from_base.leftCols<2>() - Eigen::Matrix2d::Identity()).norm();
  const bool has_texture = figures.texture >= least_texture, is_known = result.rms_px <= options.max_uncertainty_px;
  const auto shared = [](double texture) { return with_digits(100 * std::max(texture, 0.0), 3) + " %"; };
  if ((!has_texture || !is_known) && figures.unmoved_texture >= least_texture &&
      !(figures.texture >= least_kept_texture * figures.unmoved_texture)) {
    result.status = RegistrationStatus::strayed;
    message << "the search for the images' places went astray: where it moved them, " << shared(figures.texture)
            << " of their contrast is common to all, where they were " << shared(figures.unmoved_texture);
  } else if (!has_texture) {
    result.status = RegistrationStatus::no_texture;
    message << "too little texture: " << shared(figures.texture)
            << " of the contrast is common to all images, the rest is noise";
  } else if (!is_known) {
    result.status = RegistrationStatus::uncertain;
    // Not finite if the images show lines of one direction only, or texture in so small a part that nothing tells how
    // far they are turned.
    message << "its place cannot be told: its displacement is "
            << (std::isfinite(result.rms_px) ? "known to " + with_digits(result.rms_px, 3) + " px" : "not known")
            << ", expected " << with_digits(options.max_uncertainty_px, 3) << " px (capture.max_uncertainty_px)";
  } else if (!(result.displacement_px <= options.max_shift * size.width)) {
    result.status = RegistrationStatus::implausible;
    message << "displacement of " << with_digits(result.displacement_px, 3) << " px, more than "
            << 100 * options.max_shift << " % of the image width";
  } else if (!(linear <= options.max_shift)) {
    result.status = RegistrationStatus::implausible;
    message << "turned or distorted by " << with_digits(100 * linear, 3) << " %, more than " << 100 * options.max_shift
            << " %";
  } else if (!(figures.similarity >= least_similarity)) {
    result.status = RegistrationStatus::implausible;
    message << "the image does not resemble the others (similarity " << figures.similarity << ", 1 = alike)";
  } else if (!(figures.last_step_px <= 0.01)) {
    result.status = RegistrationStatus::not_converged;
    message << "its place was still changing, by " << figures.last_step_px << " px, when the search ended";
  } else {
    result.status = RegistrationStatus::ok;
  }
  result.message = message.str();
  if (result.status != RegistrationStatus::ok) result.image_from_base = identity_affine();
}

}  // namespace malus
