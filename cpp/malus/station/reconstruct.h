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
  std::string does;                    ///< one line
  std::vector<std::string> leaves;     ///< files below the workspace
  std::vector<std::string> may_leave;  ///< further files, for some stations and options
};

/// Names of all steps in their order. Last are those that the Python package runs on a finished workspace.
std::vector<std::string> step_names();

/// The steps of a run up to and including `until` (nothing = all) on a station with a prior. Throws ErrorCode::input
/// for a step that does not exist.
std::vector<StepDescription> describe_run(const Options& options, const std::optional<std::string>& until);

/// Where and how far to run.
struct RunOptions {
  std::optional<std::filesystem::path> workspace = {};  ///< nothing = keep everything in memory
  /// Take the workspace over if it belongs to another station; begin anew if its manifest is damaged.
  bool replace = false;
  std::optional<std::string> until = {};  ///< the step to run, after those it needs; nothing = all
  std::optional<std::filesystem::path> reference =
      {};  ///< cloud or mesh in the world frame to compare the surface with
  /// false: results that no later step needs are freed, which takes less memory; only the last step's results remain.
  bool keep_maps = true;
  /// Results of an earlier run in memory; those with the same inputs and options are used again.
  const Results* known = nullptr;
};

/// The whole reconstruction for a station whose camera and prior are given: from polarized images and a coarse surface
/// to a metric surface, its mesh and its assessment.
///
/// With a workspace every step's result is written there atomically and recorded in manifest.json, with its warnings.
/// Steps that are recorded with the same inputs, options and version, and whose files are unchanged, are read back
/// instead of repeated, with the same result to the bit. Throws Error; files of finished steps stay.
Results reconstruct(const Station& station, const Options& options, const RunOptions& run, const Context& context);

/// How far the surface in a workspace may be trusted: according to the assessment, or before it according to the fusion
/// alone. Returns nothing if no surface is fused. Throws an input error if the folder is no workspace.
struct SurfaceConfidence {
  Confidence confidence;
  bool assessed = false;
};
std::optional<SurfaceConfidence> surface_confidence(const std::filesystem::path& workspace);

/// Makes a folder the station's workspace, or throws as reconstruct would. For programs that write to the folder before
/// reconstruct runs.
void claim_workspace(const std::filesystem::path& folder, const Station& station, bool replace);

/// For steps that another program runs on a finished workspace: removes the files of this step and of those after it,
/// and unfinished files.
void forget_step(const std::filesystem::path& workspace, const std::string& step);
/// A step that another program has run.
struct FinishedStep {
  std::string name;
  std::vector<std::string> files;  ///< that it wrote, below the workspace
  std::string times_json;          ///< a JSON object with the time and memory that it took, for the manifest
};
/// For the same steps, once their files are written: records the step as done.
void record_step(const std::filesystem::path& workspace, const FinishedStep& finished, const Context& context);

}  // namespace malus
