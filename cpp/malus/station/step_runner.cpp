#include <algorithm>
#include <stdexcept>
#ifdef __GLIBC__
#include <malloc.h>
#endif

#include "malus/core/version.h"
#include "malus/io/sha256_internal.h"
#include "malus/station/step_runner_internal.h"
#include "malus/station/step_watch_internal.h"
#include "malus/station/surface_words_internal.h"

namespace malus {
namespace {

/// Returns unused memory to the system that a step's many small allocations leave fragmented (0.4 GB after the height
/// of 18 megapixels).
void release_unused_memory() {
#ifdef __GLIBC__
  malloc_trim(0);
#endif
}

}  // namespace

Workspace::Owner owner_of(const Station& station) {
  const std::filesystem::path& file = station.file.path;
  Json says = Json::parse(describe_station_json(station));
  if (!file.empty()) says["sha256"] = sha256_of_file(file, "station file");
  return {station.file.name, file, std::move(says)};
}

StepRunner::StepRunner(const std::vector<Step>& table, std::vector<const Step*> steps, const Station& station,
                       const Options& options, const RunOptions& run, const Context& context)
    : table_(table),
      steps_(std::move(steps)),
      station_(station),
      options_(options),
      run_(run),
      context_(context),
      option_values_(Json::parse(options_to_json(options))),
      inputs_(station, run.reference, context) {
  if (!run.workspace) return;
  workspace_ = std::make_unique<Workspace>(*run.workspace, owner_of(station), run.replace);
  workspace_->set_info("options", option_values_);
  workspace_->set_info("versions", all_versions());
  if (station.photogrammetry) {
    const Json times = Json::parse(station.photogrammetry->times_json);
    for (const auto& [name, value] : times.items()) workspace_->set_times(name, value);
  }
}

Results StepRunner::run(const Closing& closing) {
  // All inputs first, so that missing or unreadable files are reported before hours of work.
  std::vector<StationInputs::Values> values;
  for (const Step* step : steps_) values.push_back(inputs_.of(step->station));
  if (station_.photogrammetry) warnings_->all = station_.photogrammetry->warnings;
  repeat("station", station_warnings(station_));
  for (std::size_t k = 0; k < steps_.size(); ++k) {
    release(k);
    const Step& step = *steps_[k];
    const std::string key = key_of(step, values[k]);
    if (is_done(step, key)) {
      context_.progress(step.name, 1.0, "kept from an earlier run");
    } else if (workspace_ || !step.makes.empty()) {
      compute(k, key, values[k]);
    }
  }
  for (const Step* step : steps_) {
    for (const Part& part : step->makes) {
      if (run_.keep_maps || step == steps_.back()) result(part.type);
    }
  }
  if (!run_.keep_maps) {
    results_.drop_if([this](std::type_index type) { return !steps_.back()->makes_type(type); });
  }
  if (closing) {
    if (const std::optional<std::string> warning = closing(results_)) repeat("run", {*warning});
  }
  if (workspace_) workspace_->set_info("warnings", warnings_->all);
  results_.warnings = warnings_->all;
  return std::move(results_);
}

std::string StepRunner::key_of(const Step& step, const StationInputs::Values& values) {
  Json key = {{"step", step.name}, {"version", version}, {"station", values.parts}, {"options", options_of(step)}};
  key["after"] = after(step);
  if (step.reads_type(typeid(Warnings))) key["warnings"] = warnings_->all;
  return keys_[step.name] = sha256_of_bytes(key.dump());
}

std::map<std::string, std::string> StepRunner::after(const Step& step) const {
  std::map<std::string, std::string> keys;
  for (const Step* before : steps_) {
    if (before->name == step.name) break;
    if (uses(step, *before)) keys[before->name] = keys_.at(before->name);
  }
  return keys;
}

Json StepRunner::options_of(const Step& step) const {
  Json options = Json::object();
  for (const std::string& section : step.options) options[section] = option_values_.at(section);
  return options;
}

bool StepRunner::is_done(const Step& step, const std::string& key) {
  if (!workspace_) {
    const auto results = known(step, key);
    if (!results) return false;
    for (std::size_t k = 0; k < results->size(); ++k) results_.set(step.makes[k].type, key, (*results)[k]);
    repeat(step.name, known_warnings(step.name));
    return true;
  }
  const Workspace::Record* record = workspace_->record(step.name);
  if (record == nullptr || record->key != key) return false;
  const std::vector<std::string> changed = workspace_->changed_since(step.name, context_);
  if (!changed.empty()) {
    context_.log(LogLevel::warning, (workspace_->folder() / changed[0]).string() + " is not as the step " + step.name +
                                        " left it; the step is repeated");
    return false;
  }
  for (const Part& part : step.makes) kept_[part.type] = &step;
  repeat(step.name, record->warnings);
  return true;
}

std::optional<std::vector<std::shared_ptr<const void>>> StepRunner::known(const Step& step,
                                                                          const std::string& key) const {
  if (run_.known == nullptr || step.makes.empty()) return std::nullopt;
  std::vector<std::shared_ptr<const void>> results;
  for (const Part& part : step.makes) {
    results.push_back(run_.known->get(part.type, &key));
    if (!results.back()) return std::nullopt;
  }
  return results;
}

std::vector<std::string> StepRunner::known_warnings(const std::string& step) const {
  std::vector<std::string> warnings;
  const std::string start = step + ": ";
  for (const std::string& warning : run_.known->warnings) {
    if (warning.starts_with(start)) warnings.push_back(warning.substr(start.size()));
  }
  return warnings;
}

void StepRunner::repeat(const std::string& step, const std::vector<std::string>& warnings) {
  for (const std::string& warning : warnings) {
    warnings_->all.push_back(step + ": " + warning);
    context_.log(LogLevel::warning, warning);
  }
}

std::shared_ptr<const void> StepRunner::result(std::type_index type) {
  if (type == typeid(Warnings)) return warnings_;
  if (auto in_memory = results_.get(type, nullptr)) return in_memory;
  const auto kept = kept_.find(type);
  if (kept == kept_.end()) return nullptr;
  const Step& step = *kept->second;
  const Part& part = *std::ranges::find(step.makes, type, &Part::type);
  const std::shared_ptr<void> fresh = part.make();
  Keeper keeper(workspace_->folder(), *workspace_->record(step.name),
                [this](std::type_index other) { return result(other); });
  part.keep(fresh.get(), keeper);
  results_.set(type, keys_.at(step.name), fresh);
  return fresh;
}

StepInputs StepRunner::inputs_of(const Step& step) {
  StepInputs inputs;
  for (const Read& read : step.reads) {
    if (auto value = result(read.type)) inputs[read.type] = std::move(value);
  }
  return inputs;
}

void StepRunner::release(std::size_t next) {
  if (run_.keep_maps) return;
  results_.drop_if([&](std::type_index type) {
    return std::none_of(steps_.begin() + static_cast<std::ptrdiff_t>(next), steps_.end(),
                        [type](const Step* step) { return step->reads_type(type); });
  });
}

Context StepRunner::context_of(const std::string& step, std::vector<std::string>& warnings) {
  Context inner = context_;
  // The step ends when it is recorded, not when its function returns.
  inner.on_progress = [this, step](const Progress& part) {
    if (part.fraction < 1) context_.progress(step, part.fraction, part.message);
  };
  inner.on_log = [this, step, &warnings](LogLevel level, const std::string& message) {
    if (level == LogLevel::warning) {
      warnings.push_back(message);
      warnings_->all.push_back(step + ": " + message);
    }
    context_.log(level, message);
  };
  return inner;
}

void StepRunner::compute(std::size_t index, const std::string& key, const StationInputs::Values& values) {
  const Step& step = *steps_[index];
  context_.check_cancel();
  if (workspace_) workspace_->forget(step.name, files_of(table_, step.name));
  context_.progress(step.name, 0.0);
  StepInputs inputs = inputs_of(step);
  release(index);  // results that were read only to read the inputs back
  StepWatch watch;
  Workspace::Record record{key, after(step), values.hashes, options_of(step), {}, {}, Json::object()};
  StepFiles files;
  Json times = Json::object();
  const Context inner = context_of(step.name, record.warnings);
  std::vector<std::shared_ptr<const void>> made;
  if (auto earlier = known(step, key)) {
    made = std::move(*earlier);
    record.warnings = known_warnings(step.name);
    repeat(step.name, record.warnings);
  } else {
    const auto results = step.run({station_, options_, run_, inner, files, times}, inputs);
    made.assign(results.begin(), results.end());
  }
  inputs_.require_unchanged(values);
  if (workspace_) {
    for (std::size_t k = 0; k < made.size(); ++k) {
      Keeper keeper(files, record.notes);
      step.makes[k].keep(const_cast<void*>(made[k].get()), keeper);  // writing does not change the result
    }
    record.outputs = workspace_->examine(written(step, files, inner), inner);
    context_.check_cancel();
    release_unused_memory();
    times.update(watch.stop());
    workspace_->finish(step.name, std::move(record), std::move(times));
  }
  for (std::size_t k = 0; k < made.size(); ++k) results_.set(step.makes[k].type, key, made[k]);
  context_.progress(step.name, 1.0);
}

std::vector<std::string> StepRunner::written(const Step& step, const StepFiles& files, const Context& context) const {
  std::vector<std::string> names = files.write(workspace_->folder(), context);
  const auto has = [](const std::vector<std::string>& all, const std::string& name) {
    return std::ranges::find(all, name) != all.end();
  };
  for (const std::string& name : names) {
    if (!has(step.leaves, name) && !has(step.may_leave, name))
      throw std::logic_error("the table does not say that " + step.name + " leaves " + name);
  }
  for (const std::string& name : step.leaves) {
    if (!has(names, name)) throw std::logic_error("the table says that " + step.name + " leaves " + name);
  }
  return names;
}

}  // namespace malus
