#pragma once

#include <string>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/finding.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/evidence/phase_agreement_internal.h"
#include "malus/evidence/prior_alignment_internal.h"
#include "malus/io/station_spec.h"

namespace malus {

/// A station's data once polarization and prior are known, before the fusion.
struct BeforeFusion {
  AlignmentScene images;
  const Pose& pose;                   ///< cam_from_world
  const Image<float>& prior_depth;    ///< in the station view, NaN = none
  const PointCloud* cloud = nullptr;  ///< cloud that the prior was made of (world frame); null = another kind of prior
  bool known_linear = false;          ///< the response check found the images linear (says_linear)
  Response response{};                ///< made the images linear
};

/// All checks of the input that need no fusion: "size", "phase", "prior" (where the cloud or depth map lies) and
/// "contrast", in this order. Findings of severity error are returned, not thrown: the caller decides.
std::vector<Finding> findings_before_fusion(const BeforeFusion& input, const Context& context);

}  // namespace malus
