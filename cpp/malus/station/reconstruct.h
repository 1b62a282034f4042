#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "malus/core/context.h"
#include "malus/station/options.h"
#include "malus/station/results.h"
#include "malus/station/station.h"

namespace malus {

/// A step of a run, for people and programs.
struct StepDescription {
  std::string name;
  std::string does;                 ///< one line
  std::vector<std::string> leaves;  ///< files below the workspace; some stations have more
};

/// Names of all steps in their order, those that the Python package does with a finished workspace at the end.
std::vector<std::string> step_names();

/// The steps of a run until this one (nothing = all) on a station with a prior. Throws ErrorCode::input for a step that
/// does not exist.
std::vector<StepDescription> describe_run(const Options& options, const std::optional<std::string>& until);

/// Where and how far to run.
struct RunOptions {
  std::optional<std::filesystem::path> workspace = {};  ///< nothing = keep everything in memory
  /// Take the workspace over if it belongs to another station; begin anew if its manifest is damaged.
  bool replace = false;
  std::optional<std::string> until = {};  ///< the step to run, after those it needs; nothing = all
  std::optional<std::filesystem::path> reference =
      {};  ///< cloud or mesh in the world frame to compare the surface with
  /// false: results that no later step needs are let go, which takes less memory; only the last step's remain.
  bool keep_maps = true;
  /// Of an earlier run in memory; what was made from the same inputs and options is not made again.
  const Results* known = nullptr;
};

/// The whole job for a station whose camera and prior are given: polarized images and a coarse surface in, metric
/// surface, mesh and its assessment out.
///
/// With a workspace every step's result is written there atomically and recorded in manifest.json, with its warnings;
/// steps that are recorded with the same inputs, options and version, and whose files are as they were left, are read
/// back instead of repeated, with the same result to the bit. Throws Error; what finished steps wrote stays.
Results reconstruct(const Station& station, const Options& options, const RunOptions& run, const Context& context);

/// How far the surface that a workspace holds may be trusted: as assessed, or as the fusion alone knows it. Nothing is
/// returned if nothing is fused. Throws an input error if the folder is no workspace.
struct SurfaceConfidence {
  Confidence confidence;
  bool assessed = false;
};
std::optional<SurfaceConfidence> surface_confidence(const std::filesystem::path& workspace);

/// Makes a folder the station's workspace, or throws as reconstruct would. For programs that write to it before.
void claim_workspace(const std::filesystem::path& folder, const Station& station, bool replace);

/// For steps that another program does with a finished workspace: removes what the step, and those after it, left,
/// and what was not finished.
void forget_step(const std::filesystem::path& workspace, const std::string& step);
/// The same, once `files` below the workspace are written: marks the step as done.
void record_step(const std::filesystem::path& workspace, const std::string& step, const std::vector<std::string>& files,
                 double seconds, const Context& context);

}  // namespace malus
