#include <algorithm>

#include "malus/core/version.h"
#include "malus/io/sha256.h"
#include "malus/station/step_runner_internal.h"

namespace malus {

StepRunner::StepRunner(const Options& options, const RunOptions& run, const Context& context)
    : context_(context), until_(run.until), options_(Json::parse(options_to_json(options))) {
  if (until_ && std::ranges::find(step_names, *until_) == step_names.end()) {
    throw input_error("step " + *until_ + " does not exist");
  }
  if (run.workspace) {
    workspace_ = std::make_unique<Workspace>(*run.workspace);
    set_info("options", options_);
    set_info("versions", {{"malus", version}});
  }
}

bool StepRunner::wants(std::string_view step) const {
  return !until_ || std::ranges::find(step_names, step) <= std::ranges::find(step_names, *until_);
}

void StepRunner::set_info(const std::string& name, const Json& value) {
  if (workspace_) workspace_->set_info(name, value.dump());
}

std::string StepRunner::key_of(const std::string& step, const StepInputs& inputs) {
  Json key = {{"step", step}, {"version", version}, {"station", inputs.station}};
  for (const std::string& section : inputs.option_sections) key["options"][section] = options_.at(section);
  for (const std::string& before : inputs.after) key["after"][before] = keys_.at(before);
  return keys_[step] = sha256_of_bytes(key.dump());
}

Context StepRunner::context_of(const std::string& step) const {
  Context inner = context_;
  inner.on_progress = [this, step](const Progress& part) {
    if (part.fraction < 1) context_.progress(step, part.fraction, part.message);
  };
  return inner;
}

StepRunner::Clock::time_point StepRunner::begin(const std::string& step) {
  context_.check_cancel();
  if (workspace_) {
    workspace_->begin(step);
    // Both write fused/, so a result of the one takes the other's away.
    if (step == "fuse") workspace_->begin("refine");
    if (step == "refine") workspace_->begin("fuse");
  }
  context_.progress(step, 0.0);
  return Clock::now();
}

void StepRunner::finish(const std::string& step, const std::string& key, const std::vector<std::string>& files,
                        Clock::time_point start, const Json& notes) {
  context_.check_cancel();
  const double seconds = std::chrono::duration<double>(Clock::now() - start).count();
  if (workspace_) workspace_->finish(step, key, files, seconds, notes.dump());
  context_.progress(step, 1.0);
}

void StepRunner::report_kept(const std::string& step) const {
  context_.progress(step, 1.0, "kept from an earlier run");
}

}  // namespace malus
