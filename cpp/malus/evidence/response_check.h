#pragma once

#include <string>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/finding.h"
#include "malus/core/image.h"

namespace malus {

/// Whether the images are linear in the light, by how the sinusoid bends.
struct ResponseCheck {
  double bend = 0, bend_sigma = 0;
  Finding finding;
};

/// Light through a polarizer is I (1 + ρ cos x), x = 2 (a − φ). A power γ of it has, to second order and in terms of
/// the ρ that is seen, a further I ρ² (γ − 1) / (4 γ) cos 2x. That factor of I ρ² cos 2x is `bend`, by least squares
/// over pixels with 4 or more angles, its standard deviation by a jackknife over 8 × 8 parts: 0 for linear images,
/// −0.30 for images that are encoded for a display (γ = 1 / 2.2) and taken as linear, 0.14 for linear ones that were
/// decoded (γ = 2.2). A warning beyond half of that and 4 standard deviations.
///
/// images: 1 channel, as `response` made them linear, in [0, 1]; mask: non-zero = object, empty = everything.
ResponseCheck check_response(const std::vector<Image<float>>& images, const std::vector<double>& angles_rad,
                             const Mask& mask, const std::string& response, const Context& context);

/// What two such checks say together: of the angles as they were read, which may be wrong, and of those that fit the
/// images, which may fit a response curve. Where the two differ nothing can be said.
Finding response_finding(const Finding& as_read, const Finding& fitted);

/// Whether that check found the images linear; false: it found them bent, or could not tell.
bool says_linear(const Finding& finding);

}  // namespace malus
