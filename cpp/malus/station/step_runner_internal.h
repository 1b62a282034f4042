#pragma once

// Private to the station room: runs a step, or reads its result back when the workspace already has it.

#include <chrono>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/kept_memory.h"
#include "malus/io/workspace.h"
#include "malus/station/options.h"
#include "malus/station/reconstruct.h"
#include "malus/station/step_files_internal.h"

namespace malus {

/// What a step's result depends on beside the steps before it.
struct StepInputs {
  std::vector<std::string> after;            ///< steps whose results it uses
  std::vector<std::string> option_sections;  ///< "fusion" or a section's name
  Json station = Json::object();             ///< the parts of the station that matter, with hashes of files or arrays
};

/// Runs the steps of one reconstruction in order.
class StepRunner {
 public:
  StepRunner(const Options& options, const RunOptions& run, const Context& context);

  /// Whether the run goes as far as this step.
  bool wants(std::string_view step) const;
  const Context& context() const { return context_; }
  /// The workspace's folder, or null when everything stays in memory.
  const std::filesystem::path* folder() const { return workspace_ ? &workspace_->folder() : nullptr; }
  /// Records a value in the manifest.
  void set_info(const std::string& name, const Json& value);

  /// Result of a step: read back when the manifest has it with the same key, else computed, saved and recorded.
  /// `compute(context)` returns T; T has `save` and `load` in step_files_internal.h.
  template <class T, class Compute>
  T run(const std::string& step, const StepInputs& inputs, Compute&& compute) {
    const std::string key = key_of(step, inputs);
    if (workspace_ && workspace_->is_done(step, key)) {
      T result;
      load(result, workspace_->folder(), Json::parse(workspace_->notes(step)));
      report_kept(step);
      return result;
    }
    const auto start = begin(step);
    T result = compute(context_of(step));
    if (workspace_) {
      StepFiles files;
      const Json notes = save(result, files);
      StepOutputs outputs(*workspace_);
      files.write(outputs, context_);
      record(step, key, outputs, start, notes);
    }
    context_.progress(step, 1.0);
    return result;
  }

  /// A step that only writes files below the workspace: `write(context, outputs)`, not run in memory.
  template <class Write>
  void write(const std::string& step, const StepInputs& inputs, Write&& write_files) {
    if (!workspace_) return;
    const std::string key = key_of(step, inputs);
    if (workspace_->is_done(step, key)) {
      report_kept(step);
      return;
    }
    const auto start = begin(step);
    StepOutputs outputs(*workspace_);
    write_files(context_of(step), outputs);
    record(step, key, outputs, start, Json::object());
    context_.progress(step, 1.0);
  }

 private:
  /// Clocks at the start of a step.
  struct Start {
    std::chrono::steady_clock::time_point time;
    double cpu_seconds;
  };

  std::string key_of(const std::string& step, const StepInputs& inputs);
  /// The context for a step's computation: its parts' progress counts as the step's, which ends when it is recorded.
  Context context_of(const std::string& step) const;
  Start begin(const std::string& step);
  /// Marks the step as done in the manifest.
  void record(const std::string& step, const std::string& key, const StepOutputs& outputs, const Start& start,
              const Json& notes);
  void report_kept(const std::string& step) const;

  const Context& context_;
  KeptMemory kept_memory_;
  std::optional<std::string> until_;
  Json options_;
  std::unique_ptr<Workspace> workspace_;
  std::map<std::string, std::string> keys_;
};

}  // namespace malus
