#pragma once

#include "malus/fusion/refine_internal.h"

namespace malus {

/// Options without the two slowest parts: the search for a better minimum and the fit of the reflection lobe.
inline RefineOptions quick() {
  RefineOptions options;
  options.search = false;
  options.lobe = false;
  return options;
}

}  // namespace malus
