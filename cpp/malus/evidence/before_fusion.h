#pragma once

#include <string>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/finding.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/evidence/phase_agreement.h"
#include "malus/evidence/prior_alignment.h"
#include "malus/polarization/polarization_state.h"

namespace malus {

/// What a station consists of when polarization and prior are there and nothing is fused.
struct BeforeFusion {
  AlignmentScene images;
  const Pose& pose;                   ///< cam_from_world
  const Image<float>& prior_depth;    ///< in the station view, NaN = none
  const PointCloud* cloud = nullptr;  ///< that the prior was made of (world frame); null = another prior
  bool known_linear = false;          ///< the images follow the light, as the sinusoid says (says_linear)
  std::string response = "linear";    ///< curve that made the images linear, as the station file names it
  bool is_perspective = true;         ///< false: rays are taken for parallel
};

/// Everything that can be said of the input before any fusion: "size", "phase", "prior" (where the cloud or depth map
/// lies) and "contrast", in this order. Errors are not thrown: the caller decides.
std::vector<Finding> findings_before_fusion(const BeforeFusion& input, const Context& context);

}  // namespace malus
