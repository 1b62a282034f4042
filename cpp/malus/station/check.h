#pragma once

#include <optional>
#include <string>
#include <vector>

#include "malus/core/confidence.h"
#include "malus/core/context.h"
#include "malus/core/field_list.h"
#include "malus/core/image.h"
#include "malus/station/options.h"
#include "malus/station/station.h"

namespace malus {

/// What a run would do, and the time and memory it would take.
struct Plan {
  std::string name;
  Size size;  ///< of the polarized images
  double object_pixels = 0;
  std::vector<std::string> does;      ///< one line per step
  std::vector<std::string> warnings;  ///< what a person should know before starting
  Confidence confidence;              ///< limited by what the inputs alone show; "high" = nothing limits it yet
  double seconds = 0;                 ///< expected, with context.threads threads
  double memory_mb = 0;               ///< expected peak

  MALUS_FIELDS(name, object_pixels, does, warnings, confidence, seconds, memory_mb)
};

/// A step of a run and the seconds it is expected to take.
struct ExpectedTime {
  std::string step;
  double seconds = 0;
};

/// The run whose times are expected.
struct TimedRun {
  std::optional<std::string> until = {};  ///< its last step; nothing = all
  std::optional<Size> size = {};          ///< of the images, if their files do not give it (RAW)
};

/// Expected time of each step of a run with context.threads threads, from the images' size and the mask alone. Of a
/// station with [photos], the steps that the Python package runs are included with 0 seconds.
std::vector<ExpectedTime> expected_times(const Station& station, const Options& options, const TimedRun& run,
                                         const Context& context);

/// Reads the inputs of a station as a run would, without computing anything: images (size, levels, saturation), mask,
/// labels and the prior. Throws what the run would throw for those inputs. Time and memory come from measured costs per
/// pixel (docs/decisions/0003-cost-model.md).
Plan check_station(const Station& station, const Options& options, const Context& context);

/// The plan as JSON.
std::string plan_to_json(const Plan& plan);

}  // namespace malus
