#pragma once

#include "malus/capture/registration_internal.h"

namespace malus {

/// Least share of the gradients' energy that must be texture and not noise.
inline constexpr double least_texture = 0.1;

/// What a search for the places of all images tells of one of them.
struct RegistrationFigures {
  double texture = 0;          ///< share of the contrast that all images have in common at the places found
  double unmoved_texture = 0;  ///< the same without any move; 0 = not computed, as the moves are not in doubt
  double similarity = 0;       ///< regression of the image on the others, 1 = alike
  double last_step_px = 0;     ///< of the search
};

/// Sets the status, and the message on why a displacement is not reliable; such an image gets the identity. `result`
/// has the map, the displacement and its standard deviation that the search found.
void judge_registration(ImageRegistration& result, const RegistrationFigures& figures, Size size,
                        const RegistrationOptions& options);

}  // namespace malus
