#pragma once

#include <cstdint>
#include <string>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/options/polarization_options.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/reflection.h"

namespace malus {

/// Throws malus::Error unless a user's label image has this size and only 0 (decide), 1 (diffuse) and 2 (specular);
/// `name` is that of the image in the message.
void require_labels(const Image<std::uint8_t>& labels, const Size& size, const std::string& name = "label image");

/// Labels every valid pixel diffuse or specular and computes its zenith from the degree of polarization.
///
/// camera: of the rasters; null = orthographic. prior_normals: 3 channels, unit, camera frame, towards the camera, NaN
/// = none; null if there is no prior. labels: needed for ReflectionChoice::labels, 1 = diffuse, 2 = specular, 0 =
/// decide.
///
/// Automatic choice with a prior: the radial Stokes component R = s1 cos 2α + s2 sin 2α, α the prior's azimuth in the
/// ray's frame, is positive for diffuse and negative for specular reflection. The share of pixels with R < 0, weighted
/// by sin²θ of the prior and pooled over regions, decides: specular above one half. In flat regions the share of the
/// whole object prevails. Without a prior, degrees above the largest diffuse one are the only evidence: the whole
/// object gets one label, and a weakly polarizing specular object (near-frontal view) is labeled diffuse. The prior's
/// zenith picks the side of Brewster's angle in Eq 8; without it the side below is assumed.
ReflectionMap map_reflection(const PolarizationState& state, const Pinhole* camera, const Image<float>* prior_normals,
                             const Image<std::uint8_t>* labels, const ReflectionOptions& options,
                             const Context& context);

}  // namespace malus
