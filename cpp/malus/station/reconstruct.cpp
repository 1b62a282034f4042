#include "malus/station/reconstruct.h"

#include <algorithm>

#include "malus/core/digits_internal.h"
#include "malus/height/height_internal.h"
#include "malus/io/input_file_internal.h"
#include "malus/io/sha256_internal.h"
#include "malus/station/check_inputs_internal.h"
#include "malus/station/json_fields_internal.h"
#include "malus/station/step_runner_internal.h"

namespace malus {
namespace {

Error no_prior(const Station& station) {
  const std::string where = station.file.where();
  if (station.file.photos) {
    return input_error(
        where +
        ": making the prior from [photos] takes the Python program `malus run`; this one expects [prior] "
        "with a cloud, mesh or depth map");
  }
  return input_error(where +
                     ": [prior] is missing, expected a cloud, mesh or depth map; without one only `decompose` and "
                     "`height` can be run");
}

/// Warning for a height that was still changing at the end. More steps are not proposed: of 60 such heights of
/// rendered stations 30 steps instead of 12 brought 26 to rest, improved none by more than 3 % and made 18 worse.
std::string warning_of_moving_height(const HeightMap& height) {
  std::string text = "the height was still changing at the end";
  text += height.over_prior > most_over_prior
              ? ", " + with_digits(height.over_prior, 2) + " times as high as the prior: do not rely on it"
              : ": rely at most on its fine detail, not on its form";
  if (height.over_prior > 0) text += "; the refined surface does not use it";
  return text;
}

/// Warning if the height that was asked for could not be computed, or was still changing at the end.
std::optional<std::string> warning_of_height(const Results& results) {
  const auto height = results.get<HeightMap>();
  if (!height || height->status == HeightStatus::converged) return std::nullopt;
  if (height->status == HeightStatus::iteration_limit) return warning_of_moving_height(*height);
  return "there is no height from polarization, height/height.tif is empty: " + std::string(enum_name(height->status));
}

/// Throws an input error that lists the steps unless a run can end with this step.
void require_step(const std::string& name) {
  std::string known;
  for (const Step& step : step_table()) {
    if (step.run && step.name == name) return;
    if (step.run && !known.ends_with(step.name)) known += (known.empty() ? "" : ", ") + step.name;
  }
  throw input_error("step " + name + " does not exist, expected one of " + known);
}

}  // namespace

std::vector<std::string> step_names() {
  std::vector<std::string> names;
  for (const Step& step : step_table()) {
    if (names.empty() || names.back() != step.name) names.push_back(step.name);
  }
  return names;
}

std::vector<StepDescription> describe_run(const Options& options, const std::optional<std::string>& until) {
  if (until) require_step(*until);
  Station complete;
  complete.prior = DepthFile{};
  std::vector<StepDescription> steps;
  for (const Step* step : steps_of_run(step_table(), complete, options, until))
    steps.push_back({step->name, step->does, step->leaves, step->may_leave});
  return steps;
}

Results reconstruct(const Station& station, const Options& options, const RunOptions& run, const Context& context) {
  options.validate();
  context.validate();
  if (run.until) require_step(*run.until);
  std::vector<const Step*> steps = steps_of_run(step_table(), station, options, run.until);
  if (!station.has_prior() && (!run.until || steps.empty())) throw no_prior(station);
  if (std::ranges::any_of(steps, [](const Step* step) { return step->makes_type(typeid(DepthPrior)); }))
    require_camera(station.file);
  // Other runs do not need the height; their report says what is missing.
  const StepRunner::Closing closing = run.until == "height" ? warning_of_height : StepRunner::Closing();
  return StepRunner(step_table(), std::move(steps), station, options, run, context).run(closing);
}

std::optional<SurfaceConfidence> surface_confidence(const std::filesystem::path& folder) {
  const Json steps = Workspace::read_manifest(folder).at("steps");
  SurfaceConfidence found{{}, steps.contains("assess")};
  if (found.assessed) {
    fields_from_json(found.confidence, Json::parse(read_file(folder / "quality.json", "assessment")).at("confidence"));
  } else if (steps.contains("fuse")) {
    fields_from_json(found.confidence, steps.at("fuse").at("notes").at("confidence"));
  } else {
    return std::nullopt;
  }
  return found;
}

void claim_workspace(const std::filesystem::path& folder, const Station& station, bool replace) {
  const Workspace workspace(folder, owner_of(station), replace);
}

void forget_step(const std::filesystem::path& folder, const std::string& name) {
  Workspace workspace(folder);
  workspace.remove_unfinished();
  workspace.forget(name, files_of(step_table(), name));
}

void record_step(const std::filesystem::path& folder, const FinishedStep& finished, const Context& context) {
  const std::vector<Step>& table = step_table();
  const auto step = std::ranges::find(table, finished.name, &Step::name);
  if (step == table.end()) throw input_error("step " + finished.name + " does not exist");
  Workspace workspace(folder);
  Workspace::Record record;
  for (auto maker = table.begin(); maker != step; ++maker) {
    const Workspace::Record* before = workspace.record(maker->name);
    if (before != nullptr && uses(*step, *maker)) record.after[maker->name] = before->key;
  }
  record.key = sha256_of_bytes(Json(record.after).dump());
  record.outputs = workspace.examine(finished.files, context);
  workspace.finish(finished.name, std::move(record), Json::parse(finished.times_json));
}

}  // namespace malus
