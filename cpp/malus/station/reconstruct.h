#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "malus/assess/quality.h"
#include "malus/core/context.h"
#include "malus/fusion/fused_surface.h"
#include "malus/height/height_map.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/polarizer_calibration.h"
#include "malus/polarization/reflection.h"
#include "malus/prior/depth_prior.h"
#include "malus/station/options.h"
#include "malus/station/station.h"

namespace malus {

/// The steps of a reconstruction in their order; `report` is made by the Python package from the finished workspace.
inline constexpr std::array<std::string_view, 9> step_names{"polarization", "prior",  "polarizer", "zenith", "height",
                                                            "fuse",         "refine", "mesh",      "assess"};

/// Where and how far to run.
struct RunOptions {
  std::optional<std::filesystem::path> workspace;  ///< nothing = keep everything in memory
  std::optional<std::string> until;                ///< last step to run; nothing = all
  std::optional<std::filesystem::path> reference;  ///< cloud or mesh in the world frame to compare the surface with
  /// false: maps that no later step needs are let go, which takes less memory, and the result has figures only.
  bool keep_maps = true;
};

/// What was computed; a step that was not run leaves its member empty.
struct Reconstruction {
  PolarizationState polarization;
  Image<float> scene;  ///< for a station with photos: unpolarized intensity of all that is in view, object or not
  std::optional<DepthPrior> prior;
  PolarizerCalibration polarizer;
  std::optional<ReflectionMap> reflection;
  std::optional<HeightMap> height;
  std::optional<FusedSurface> surface;
  std::optional<Quality> quality;
  std::string quality_json;  ///< content of quality.json: the figures, the station's name, the refinement's report
};

/// The whole job for a station whose camera and prior are given: polarized images and a coarse surface in, metric
/// surface, mesh and its assessment out.
///
/// With a workspace every step's result is written there atomically and recorded in manifest.json; steps that are
/// recorded with the same inputs, options and version are read back instead of repeated, with the same result to the
/// bit. Throws Error; what finished steps wrote stays.
Reconstruction reconstruct(const Station& station, const Options& options, const RunOptions& run,
                           const Context& context);

}  // namespace malus
