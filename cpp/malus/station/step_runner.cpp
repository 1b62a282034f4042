#include <sys/resource.h>
#ifdef __GLIBC__
#include <malloc.h>
#endif

#include <algorithm>

#include "malus/core/version.h"
#include "malus/io/sha256.h"
#include "malus/station/step_runner_internal.h"

namespace malus {
namespace {

rusage use_of_process() {
  rusage use{};
  getrusage(RUSAGE_SELF, &use);
  return use;
}

/// Processor time of all threads so far.
double cpu_seconds() {
  const rusage use = use_of_process();
  return static_cast<double>(use.ru_utime.tv_sec + use.ru_stime.tv_sec) +
         1e-6 * static_cast<double>(use.ru_utime.tv_usec + use.ru_stime.tv_usec);
}

double peak_mb() {
  return static_cast<double>(use_of_process().ru_maxrss) * 1024 / 1e6;
}

/// Gives the memory back that a step's many small allocations leave scattered (0.4 GB after the height of 18
/// megapixels), and large memory beyond what the short steps take: kept, it would add to what the next step gets
/// elsewhere, as a factor.
void release_unused_memory() {
  constexpr std::size_t kept_between_steps = 512'000'000;
  KeptMemory::limit(kept_between_steps);
#ifdef __GLIBC__
  malloc_trim(0);
#endif
}

}  // namespace

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

StepRunner::Start StepRunner::begin(const std::string& step) {
  context_.check_cancel();
  if (workspace_) {
    workspace_->begin(step);
    // Both write fused/, so a result of the one takes the other's away.
    if (step == "fuse") workspace_->begin("refine");
    if (step == "refine") workspace_->begin("fuse");
  }
  context_.progress(step, 0.0);
  return {std::chrono::steady_clock::now(), cpu_seconds()};
}

void StepRunner::record(const std::string& step, const std::string& key, const StepOutputs& outputs, const Start& start,
                        const Json& notes) {
  context_.check_cancel();
  release_unused_memory();
  const std::chrono::duration<double> time = std::chrono::steady_clock::now() - start.time;
  const Workspace::Use use{time.count(), cpu_seconds() - start.cpu_seconds, peak_mb()};
  workspace_->finish(step, key, outputs.written(), use, notes.dump());
}

void StepRunner::report_kept(const std::string& step) const {
  context_.progress(step, 1.0, "kept from an earlier run");
}

}  // namespace malus
