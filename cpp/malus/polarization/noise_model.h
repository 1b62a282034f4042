#pragma once

#include <algorithm>

#include "malus/core/field_list.h"

namespace malus {

/// Noise of a linear intensity in [0, 1] of the white level: shot noise, read noise, quantization, averaged frames.
struct NoiseModel {
  double full_well_e = 20000;  ///< electrons at white level
  double read_noise_e = 8;     ///< electrons RMS
  double quantization = 0;     ///< one digital number as a share of the white level
  int frames_averaged = 1;

  MALUS_FIELDS(full_well_e, read_noise_e, quantization, frames_averaged)

  /// Variance of one (averaged) intensity whose expectation is `signal`.
  double variance(double signal) const {
    const double electrons = std::max(signal, 0.0) * full_well_e + read_noise_e * read_noise_e;
    return electrons / (full_well_e * full_well_e) / frames_averaged + quantization * quantization / 12.0;
  }
};

}  // namespace malus
