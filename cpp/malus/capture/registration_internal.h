#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>

#include "malus/capture/resampling_internal.h"
#include "malus/core/context.h"
#include "malus/core/field_list.h"
#include "malus/core/image.h"
#include "malus/options/capture_options.h"
#include "malus/polarization/noise_model.h"

namespace malus {

/// How the registration of one image ended.
enum class RegistrationStatus { not_run, ok, no_texture, uncertain, strayed, not_converged, implausible };
constexpr auto names_of(RegistrationStatus) {
  return std::to_array<std::string_view>(
      {"not run", "ok", "no texture", "uncertain", "strayed", "not converged", "implausible"});
}

/// Registration of one image to the first.
struct ImageRegistration {
  RegistrationStatus status = RegistrationStatus::not_run;
  std::string message;                         ///< what happened, when it is not ok
  Affine image_from_base = identity_affine();  ///< pixel of the first image → pixel of this one
  double displacement_px = 0;                  ///< RMS over the image's corners and center
  /// One standard deviation of the displacement, RMS over corners and center, from the scatter of the normal equations
  /// between 96 parts of the image (sandwich estimate): includes errors that noise alone does not explain, such as
  /// edges whose polarization changes their contrast. The part of the normal equations that noise explains counts as no
  /// information. Infinite if noise explains nearly all of them for some kind of displacement.
  double rms_px = 0;

  MALUS_FIELDS(status, message, image_from_base, displacement_px, rms_px)
};

/// Registers linear images of one size to the first, by 6-parameter affine maps, all together.
///
/// Images are compared by their contrast in a band of scales: b_k = (G_fine − G_coarse) I_k / G_coarse I_k. Coarse to
/// fine, Gauss–Newton minimizes the weighted squares of b_k(W_k x) − mean_j b_j(W_j x), W_1 = identity, with the common
/// gradient of the mean. Then the normal equations of all images share one 6 × 6 matrix H: with g_k the right-hand side
/// of image k, the step is p_k = H⁻¹ (g_k − g_1). Weights: inverse noise variance times Cauchy in the disagreement of
/// all images at that pixel, scaled by its lower quartile, so that pixels that change with the polarizer's angle get
/// little weight. Start: phase correlation at the coarsest level. The whole image is used, background included: texture
/// around an object fixes the camera's motion better than the object alone.
///
/// Input error when sizes differ. An image that cannot be registered has a status, the identity and a message.
std::vector<ImageRegistration> register_images(const std::vector<Image<float>>& images, const NoiseModel& noise,
                                               const RegistrationOptions& options, const Context& context);

}  // namespace malus
