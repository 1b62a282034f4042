#pragma once

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/stereo/surface_sweep.h"
#include "malus/stereo/sweep_pass_internal.h"

namespace malus {

/// What the last sweeps left for judging them.
struct AgreementInput {
  const PassResult* pass = nullptr;                ///< of the last sweep
  const Image<float>* wide_difference_px = nullptr;  ///< of the halves in the wider sweep before, px of parallax
  float step = 0;                                  ///< of the last sweep, in ln z
  double rate = 1;                                 ///< px of parallax a unit of ln z
  double focal = 1;
  bool halves_compared = true;
};

/// Depth, sigma and confidence from the last sweep and from how far the disjoint halves of the photos agree around each
/// pixel; drops pixels that fail.
void judge(const AgreementInput& input, const Mask& mask, const SweepOptions& options, const Context& context,
           SweepResult& result);

}  // namespace malus
