#pragma once

// Private to the station room: the description of a step. steps.cpp has the table of all steps. Running, resuming,
// describing and estimating the cost of a reconstruction all follow from that table.

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <tuple>
#include <typeindex>
#include <utility>
#include <vector>

#include "malus/station/cost_model_internal.h"
#include "malus/station/kept_results_internal.h"
#include "malus/station/reconstruct.h"
#include "malus/station/station_inputs_internal.h"

namespace malus {

/// Arguments of a step's function, besides the results it reads.
struct Job {
  const Station& station;
  const Options& options;
  const RunOptions& run;
  const Context& context;  ///< its progress and warnings are reported as the step's
  StepFiles& files;  ///< for files that belong to no result; their write functions may refer only to the results read
  Json& times;       ///< figures that differ between identical runs, for the manifest
};

/// Warnings of the steps so far, including the reading step's own, "<step>: <sentence>". A step that reads them depends
/// on all steps before it.
struct Warnings {
  std::vector<std::string> all;
};

/// A row of the table, without the function.
struct StepRow {
  std::string name = {};
  std::string does = {};                          ///< for people
  std::vector<std::string> options = {};          ///< sections, or "fusion"
  std::vector<StationInputs::Part> station = {};  ///< parts of the station that the step uses
  std::vector<std::string> leaves = {};           ///< files
  std::vector<std::string> may_leave = {};        ///< further files, for some stations and options
  /// For a step that the Python package runs before the library does: the step that uses what it finds.
  std::string serves = {};
  Expected (*cost)(const Workload&) = nullptr;
  /// Whether this row is the variant of the step to use.
  bool (*applies)(const Station&, const Options&) = [](const Station&, const Options&) { return true; };
  /// Whether the step is run even if no other step of the run needs its result.
  bool (*on_its_own)(const Options&) = [](const Options&) { return true; };
};

/// A result type that a step makes.
struct Part {
  std::type_index type;
  std::shared_ptr<void> (*make)();
  void (*keep)(void* result, Keeper& keeper);  ///< changes the result only when reading
};

/// A result type that a step reads.
struct Read {
  std::type_index type;
  bool is_required;
};

using StepInputs = std::map<std::type_index, std::shared_ptr<const void>>;

struct Step : StepRow {
  std::vector<Part> makes = {};
  std::vector<Read> reads = {};
  /// Returns results in the order of `makes`; empty for steps that the Python package runs.
  std::function<std::vector<std::shared_ptr<void>>(const Job&, const StepInputs&)> run = {};

  bool reads_type(std::type_index type) const;
  bool makes_type(std::type_index type) const;
};

/// An argument of a step's function: `const T&` is a result that the step needs, `const T*` one that it uses if the run
/// has it.
template <class Argument>
struct StepArgument;
template <class T>
struct StepArgument<const T&> {
  static Read read() { return {typeid(T), true}; }
  static const T& of(const StepInputs& inputs) { return *static_cast<const T*>(inputs.at(typeid(T)).get()); }
};
template <class T>
struct StepArgument<const T*> {
  static Read read() { return {typeid(T), false}; }
  static const T* of(const StepInputs& inputs) {
    const auto found = inputs.find(typeid(T));
    return found == inputs.end() ? nullptr : static_cast<const T*>(found->second.get());
  }
};

template <class T>
Part part_of() {
  return {typeid(T), []() -> std::shared_ptr<void> { return std::make_shared<T>(); },
          [](void* result, Keeper& keeper) { keep(*static_cast<T*>(result), keeper); }};
}

/// What a step's function returns: one result, a tuple of them, or nothing.
template <class Returned>
struct StepResult {
  static std::vector<Part> parts() { return {part_of<Returned>()}; }
  template <class Call>
  static std::vector<std::shared_ptr<void>> of(Call&& call) {
    return {std::make_shared<Returned>(call())};
  }
};
template <class... Parts>
struct StepResult<std::tuple<Parts...>> {
  static std::vector<Part> parts() { return {part_of<Parts>()...}; }
  template <class Call>
  static std::vector<std::shared_ptr<void>> of(Call&& call) {
    return std::apply(
        [](auto&&... parts) {
          return std::vector<std::shared_ptr<void>>{std::make_shared<Parts>(std::forward<decltype(parts)>(parts))...};
        },
        call());
  }
};
template <>
struct StepResult<void> {
  static std::vector<Part> parts() { return {}; }
  template <class Call>
  static std::vector<std::shared_ptr<void>> of(Call&& call) {
    call();
    return {};
  }
};

/// Makes a row of the table. The step reads the arguments of its function and makes the results that it returns.
template <class Returned, class... Arguments>
Step step(StepRow row, Returned (*function)(const Job&, Arguments...)) {
  Step result{std::move(row)};
  result.makes = StepResult<Returned>::parts();
  result.reads = {StepArgument<Arguments>::read()...};
  result.run = [function](const Job& job, const StepInputs& inputs) {
    return StepResult<Returned>::of([&] { return function(job, StepArgument<Arguments>::of(inputs)...); });
  };
  return result;
}

/// A row for a step that the Python package runs on a workspace with these results, and records by record_step.
template <class... Results>
Step step_by_python(StepRow row) {
  Step result{std::move(row)};
  result.reads = {Read{typeid(Results), true}...};
  return result;
}

/// All steps, in an order in which each comes after those whose results it reads.
const std::vector<Step>& step_table();

/// The steps of a run, in their order: `until` (nothing = all) and the steps it needs, as far as the station has their
/// inputs.
std::vector<const Step*> steps_of_run(const std::vector<Step>& table, const Station& station, const Options& options,
                                      const std::optional<std::string>& until);

/// The steps of a run as people see them: those of steps_of_run, and in their places those that the Python package runs
/// for them. A station with [photos] is taken as one whose prior is made from these.
std::vector<const Step*> planned_steps(const std::vector<Step>& table, const Station& station, const Options& options,
                                       const std::optional<std::string>& until);

/// Whether `reader` uses results of `maker`, a step before it.
bool uses(const Step& reader, const Step& maker);

/// Files that any variant of the step of this name may leave.
std::vector<std::string> files_of(const std::vector<Step>& table, const std::string& step);

}  // namespace malus
