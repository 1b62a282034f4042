#pragma once

#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/finding.h"
#include "malus/core/image.h"
#include "malus/polarization/phase_coherence_internal.h"
#include "malus/polarization/polarization_state.h"

namespace malus {

/// Agreement of the measured phases with the azimuths of the prior, for diffuse and specular reflection alike: overall,
/// and in parts of the image.
struct PhaseAgreement {
  PhaseCoherence overall;

  /// Parts of the cells' bounding box, row by row. Parts with fewer than 50 cells have a disagreement of NaN.
  static constexpr int parts_per_side = 6;
  struct Part {
    double u = 0, v = 0;  ///< mean position of its cells [px]
    double cells = 0;
    double disagreement = 0, disagreement_sigma = 0;  ///< as in PhaseCoherence
  };
  std::vector<Part> parts;

  /// Of the parts that have a disagreement, the share that is no better than unrelated data (disagreement above 0.6 by
  /// more than 2 standard deviations).
  double unrelated_share = 0;

  /// Phases and azimuths are both known well, but unrelated.
  bool is_unrelated = false;

  Finding finding;
};

/// Compares phases with the azimuths of the prior's normals. camera null = orthographic; normals: 3 channels, unit,
/// camera frame, towards the camera, NaN = none.
///
/// The finding is an error if the polarization certainly turns against the azimuths (knows_direction), and a warning if
/// it is turned by more than 10° (knows_zero). It is also a warning if phases and azimuths are both known well, but
/// unrelated: metal, a prior in the wrong place, images of another object, angles in the wrong order. If they are
/// related only weakly, or one of them is not known (flat object, too little polarization), the finding states that the
/// agreement could not be checked.
PhaseAgreement phase_agreement(const PolarizationState& state, const Pinhole* camera, const Image<float>& normals,
                               const Context& context);

}  // namespace malus
