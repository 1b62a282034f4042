#pragma once

// Private to the station room: runs the steps of a table, or reads their results back if the workspace has them.

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <typeindex>
#include <vector>

#include "malus/io/workspace_internal.h"
#include "malus/station/step_internal.h"

namespace malus {

/// Identifies a station as the owner of a workspace.
Workspace::Owner owner_of(const Station& station);

/// One reconstruction. The code depends on no particular step.
class StepRunner {
 public:
  /// `table` has all steps, `steps` those of this run; both must outlive this object.
  StepRunner(const std::vector<Step>& table, std::vector<const Step*> steps, const Station& station,
             const Options& options, const RunOptions& run, const Context& context);

  /// Returns a warning about the results of a run, if there is one.
  using Closing = std::function<std::optional<std::string>(const Results&)>;

  /// Runs the steps that are not done. RunOptions::keep_maps decides which results remain. A warning of `closing`
  /// belongs to this run and to no step, because a run with other steps does not give it.
  Results run(const Closing& closing = {});

 private:
  /// Whether the step's results exist with this key, in the workspace or, without a workspace, from an earlier run. If
  /// so, takes them over.
  bool is_done(const Step& step, const std::string& key);
  /// The step's results of an earlier run in memory; nothing unless all of them exist with this key.
  std::optional<std::vector<std::shared_ptr<const void>>> known(const Step& step, const std::string& key) const;
  /// Logs warnings that no running step logs: those of a step that is not repeated, of the station itself ("station"),
  /// or of the run ("run").
  void repeat(const std::string& step, const std::vector<std::string>& warnings);
  /// The step's warnings of the earlier run in memory.
  std::vector<std::string> known_warnings(const std::string& step) const;
  void compute(std::size_t index, const std::string& key, const StationInputs::Values& values);
  /// Writes the files of a step, which must be among those in its row.
  std::vector<std::string> written(const Step& step, const StepFiles& files, const Context& context) const;
  std::string key_of(const Step& step, const StationInputs::Values& values);
  /// The steps of this run whose results `step` uses, and their keys.
  std::map<std::string, std::string> after(const Step& step) const;
  /// Values of the option sections that the step depends on.
  Json options_of(const Step& step) const;
  /// A result of an earlier step, read back if it is not in memory.
  std::shared_ptr<const void> result(std::type_index type);
  /// The results that the step reads, as far as the run has them.
  StepInputs inputs_of(const Step& step);
  /// Frees results that no step from index `next` on reads.
  void release(std::size_t next);
  /// A context that reports progress and warnings as the step's, and adds the warnings to `warnings`.
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
  std::map<std::type_index, const Step*> kept_;  ///< results in the workspace, and the steps that wrote them
  std::map<std::string, std::string> keys_;
  std::shared_ptr<Warnings> warnings_ = std::make_shared<Warnings>();
};

}  // namespace malus
