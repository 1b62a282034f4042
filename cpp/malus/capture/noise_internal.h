#pragma once

#include <array>
#include <optional>

#include "malus/capture/response_internal.h"
#include "malus/io/station_spec.h"
#include "malus/polarization/noise_model.h"

namespace malus {

/// Estimates shot and read noise of a linear image from the image alone (photon transfer). Noise in 8 × 8 blocks: with
/// the mask (1 −2 1; −2 4 −2; 1 −2 1) / 6 of Immerkær (1996). Noise per bin of intensity: the lower decile over the
/// blocks (those with the least texture). A straight line variance = read² + signal / full well is fitted through the
/// bins. An upper bound where everything is textured. Nothing when fewer than 100 unsaturated blocks exist.
std::optional<NoiseModel> estimate_noise(const Image<float>& intensity, const Mask& saturated);

/// Noise model of a station's linear images. Full well and read noise come from the station file; without a full well
/// there, what is missing comes from estimate_noise, for a color mosaic from the samples of one filter; else they are
/// 20000 and 8 electrons. The model also includes:
///  - the weighted sum of color channels, Σ w² of one channel's variance and quantization;
///  - quantization behind a response curve that is not linear: its variance slope² step² / 12 grows about linearly with
///    the signal, so it is carried as additional shot noise (matched at half of white), plus a constant part at black.
///    Estimated shot noise is at least that.
NoiseModel noise_model(const PolarizedSpec& spec, const ResponseCurve& curve, const Levels& levels,
                       const std::optional<std::array<double, 3>>& color_weights, const LinearImage& base);

}  // namespace malus
