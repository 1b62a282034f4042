#pragma once

// Private to the station room: what each step is expected to take (docs/decisions/0003-cost-model.md).

#include "malus/station/options.h"
#include "malus/station/station.h"

namespace malus {

/// What a step's cost depends on.
struct Workload {
  const Station& station;
  const Options& options;
  Size size;              ///< of the images
  double object_mpx = 0;  ///< megapixels of the object
  int threads = 1;
};

struct Expected {
  double seconds = 0;
  double megabytes = 0;  ///< most memory of the process in the step, what is kept from earlier ones included
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
