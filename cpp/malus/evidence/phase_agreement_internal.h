#pragma once

#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/finding.h"
#include "malus/core/image.h"
#include "malus/polarization/phase_coherence_internal.h"
#include "malus/polarization/polarization_state.h"

namespace malus {

/// Agreement of the measured phases with the azimuths of the prior, whatever each place reflects: overall, and in parts
/// of the image.
struct PhaseAgreement {
  PhaseCoherence overall;

  /// Parts of the box about the cells, row by row. A part with fewer than 50 cells has none: disagreement NaN.
  static constexpr int parts_per_side = 6;
  struct Part {
    double u = 0, v = 0;  ///< mean position of its cells [px]
    double cells = 0;
    double disagreement = 0, disagreement_sigma = 0;  ///< as in PhaseCoherence
  };
  std::vector<Part> parts;

  /// Of the parts that have a disagreement, the share that is no better than unrelated data (0.6 and more, with 2
  /// standard deviations to where the rest lies).
  double unrelated_share = 0;

  /// Phases and azimuths are both known well, and yet have nothing to do with each other.
  bool is_unrelated = false;

  Finding finding;
};

/// Compares phases with the azimuths of the prior's normals. camera null = orthographic; normals: 3 channels, unit,
/// camera frame, towards the camera, NaN = none.
///
/// An error where the polarization certainly turns against the azimuths (knows_direction), a warning where it is turned
/// by more than 10° (knows_zero). A warning, too, where phases and azimuths are both known well, and yet unrelated or
/// related only weakly: metal, a prior in the wrong place, images of another object, angles in the wrong order. Where
/// either is not known (flat object, too little polarization) the finding says that it could not be checked.
PhaseAgreement phase_agreement(const PolarizationState& state, const Pinhole* camera, const Image<float>& normals,
                               const Context& context);

}  // namespace malus
