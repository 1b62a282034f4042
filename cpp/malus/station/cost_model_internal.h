#pragma once

// Private to the station room: expected time and memory of each step (docs/decisions/0003-cost-model.md).

#include "malus/station/options.h"
#include "malus/station/station.h"

namespace malus {

/// Quantities that a step's cost depends on.
struct Workload {
  const Station& station;
  const Options& options;
  Size size;              ///< of the images
  double object_mpx = 0;  ///< megapixels of the object
  int threads = 1;
};

struct Expected {
  double seconds = 0;
  double megabytes = 0;  ///< peak memory of the process in the step, including results kept from earlier steps
};

Expected polarization_cost(const Workload& work);
Expected prior_cost(const Workload& work);
Expected polarizer_cost(const Workload& work);
Expected evidence_cost(const Workload& work);
Expected zenith_cost(const Workload& work);
Expected height_cost(const Workload& work);
Expected grid_cost(const Workload& work);
Expected refined_cost(const Workload& work);
Expected mesh_cost(const Workload& work);
Expected assess_cost(const Workload& work);

}  // namespace malus
