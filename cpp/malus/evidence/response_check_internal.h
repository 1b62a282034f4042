#pragma once

#include <string>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/finding.h"
#include "malus/core/image.h"
#include "malus/io/station_spec.h"

namespace malus {

/// Whether the images are linear in the light, judged by the distortion of the sinusoid.
struct ResponseCheck {
  double bend = 0, bend_sigma = 0;
  Finding finding;
};

/// Light through a polarizer is I (1 + ρ cos x), x = 2 (a − φ). Its power γ has, to second order and with the apparent
/// ρ, an additional term I ρ² (γ − 1) / (4 γ) cos 2x. `bend` is this factor of I ρ² cos 2x, by least squares over the
/// pixels of images at 4 or more angles; its standard deviation comes from a jackknife over 8 × 8 parts. It is 0 for
/// linear images, −0.30 for images encoded for a display (γ = 1 / 2.2) and taken as linear, and 0.14 for linear images
/// that were decoded (γ = 2.2). Beyond half of these and 4 standard deviations the finding is a warning; a positive
/// bend though the response is linear has another cause and gives a note.
///
/// images: 1 channel, after `response` was applied to make them linear, in [0, 1]; mask: non-zero = object, empty =
/// everything.
ResponseCheck check_response(const std::vector<Image<float>>& images, const std::vector<double>& angles_rad,
                             const Mask& mask, const Response& response, const Context& context);

/// Combines two such checks: with the angles as read, which may be wrong, and with angles fitted to the images, which
/// may compensate a response curve. If their severities differ, the finding is that linearity could not be checked.
Finding response_finding(const Finding& as_read, const Finding& fitted);

/// Whether check_response found the images linear; false: it found them not linear, or could not decide.
bool says_linear(const Finding& finding);

}  // namespace malus
