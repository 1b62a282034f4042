#pragma once

#include "malus/fusion/refine_internal.h"

namespace malus {

/// Refinement without what takes longest: the search of the start and the lobe of the reflection.
inline RefineOptions quick() {
  RefineOptions options;
  options.search = false;
  options.lobe = false;
  return options;
}

}  // namespace malus
