#pragma once

// Private to the station room: runs the steps of a table, or reads their results back when the workspace has them.

#include <memory>
#include <optional>
#include <string>
#include <typeindex>
#include <vector>

#include "malus/io/workspace_internal.h"
#include "malus/station/step_internal.h"

namespace malus {

/// What identifies a station as the owner of a workspace.
Workspace::Owner owner_of(const Station& station);

/// One reconstruction. Knows no step by name.
class StepRunner {
 public:
  /// `table` has all steps, `steps` those of this run, which must outlive this.
  StepRunner(const std::vector<Step>& table, std::vector<const Step*> steps, const Station& station,
             const Options& options, const RunOptions& run, const Context& context);

  /// Runs the steps that are not done. What results are left is as RunOptions::keep_maps says.
  Results run();

 private:
  /// Takes a step's results from the workspace, or without one from an earlier run, if they are there with this key.
  bool is_done(const Step& step, const std::string& key);
  /// The step's results of an earlier run in memory; nothing unless all of them are there with this key.
  std::optional<std::vector<std::shared_ptr<const void>>> known(const Step& step, const std::string& key) const;
  /// Says warnings that no step of this run logs: of a step that is not run, or of the station itself.
  void repeat(const std::string& step, const std::vector<std::string>& warnings);
  /// Its warnings of the earlier run in memory.
  std::vector<std::string> known_warnings(const std::string& step) const;
  void compute(std::size_t index, const std::string& key, const StationInputs::Values& values);
  /// Writes the files of a step, which must be among those that its row names.
  std::vector<std::string> written(const Step& step, const StepFiles& files, const Context& context) const;
  std::string key_of(const Step& step, const StationInputs::Values& values);
  /// The steps of this run whose results it uses, and their keys.
  std::map<std::string, std::string> after(const Step& step) const;
  /// The sections that the step depends on.
  Json options_of(const Step& step) const;
  /// A result that an earlier step has made, read back if it is not in memory.
  std::shared_ptr<const void> result(std::type_index type);
  /// Those that the step reads, as far as the run has them.
  StepInputs inputs_of(const Step& step);
  /// Lets go of results that no step of the run from this one on reads.
  void release(std::size_t next);
  /// A context whose progress and warnings are the step's, the latter added to `warnings`.
  Context context_of(const std::string& step, std::vector<std::string>& warnings);

  const std::vector<Step>& table_;
  const std::vector<const Step*> steps_;
  const Station& station_;
  const Options& options_;
  const RunOptions& run_;
  const Context& context_;
  const Json option_values_;
  std::unique_ptr<Workspace> workspace_;
  StationInputs inputs_;
  Results results_;
  std::map<std::type_index, const Step*> kept_;  ///< results that the workspace has, and the steps that left them
  std::map<std::string, std::string> keys_;
  std::shared_ptr<Warnings> warnings_ = std::make_shared<Warnings>();
};

}  // namespace malus
