#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>

#include "malus/station/step_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

std::vector<std::string> names_of_run(const Station& station, const Options& options,
                                      const std::optional<std::string>& until = std::nullopt) {
  std::vector<std::string> names;
  for (const Step* step : steps_of_run(step_table(), station, options, until)) names.push_back(step->name);
  return names;
}

Station with_prior() {
  Station station;
  station.prior = DepthFile{"depth.tif"};
  return station;
}

Options by_grid() {
  Options options;
  options.fusion = Fusion::grid;
  return options;
}

using Names = std::vector<std::string>;

TEST(StepTable, EveryStepComesAfterTheStepsItReads) {
  std::set<std::type_index> made{typeid(Warnings)};
  for (const Step& step : step_table()) {
    for (const Read& read : step.reads) EXPECT_TRUE(made.contains(read.type)) << step.name;
    for (const Part& part : step.makes) made.insert(part.type);
    EXPECT_FALSE(step.does.empty()) << step.name;
    EXPECT_EQ(step.leaves.empty(), !step.serves.empty()) << step.name;
    EXPECT_EQ(step.cost == nullptr, step.run == nullptr) << step.name;
  }
}

TEST(StepTable, NoTwoStepsLeaveTheSameFile) {
  std::map<std::string, std::string> owner;
  for (const Step& step : step_table()) {
    for (const std::string& file : files_of(step_table(), step.name))
      EXPECT_EQ(owner.emplace(file, step.name).first->second, step.name) << file;
  }
}

TEST(StepTable, OnlyTheFusionDependsOnTheMetal) {
  for (const Step& step : step_table()) {
    const bool depends = std::ranges::find(step.station, &StationInputs::metal) != step.station.end();
    EXPECT_EQ(depends, step.name == "fuse") << step.name;
  }
}

TEST(StepTable, ARunHasTheStepsItNeeds) {
  const Options refined;
  EXPECT_EQ(names_of_run(with_prior(), refined),
            (Names{"polarization", "prior", "polarizer", "evidence", "zenith", "height", "fuse", "mesh", "assess"}));
  EXPECT_EQ(names_of_run(with_prior(), by_grid()), names_of_run(with_prior(), refined));
  EXPECT_EQ(names_of_run(with_prior(), refined, "fuse"),
            (Names{"polarization", "prior", "polarizer", "evidence", "fuse"}));
  EXPECT_EQ(names_of_run(with_prior(), by_grid(), "fuse"),
            (Names{"polarization", "prior", "polarizer", "evidence", "zenith", "height", "fuse"}));
  EXPECT_EQ(names_of_run(with_prior(), refined, "polarization"), Names{"polarization"});
  EXPECT_EQ(names_of_run(with_prior(), refined, "prior"), (Names{"polarization", "prior"}));
  EXPECT_EQ(names_of_run(with_prior(), refined, "assess"), names_of_run(with_prior(), refined))
      << "quality.json has the warnings of all steps";
}

TEST(StepTable, ZenithAndHeightCanBeLeftOut) {
  Options options;
  options.assess.polarization_height = false;
  EXPECT_EQ(names_of_run(with_prior(), options),
            (Names{"polarization", "prior", "polarizer", "evidence", "fuse", "mesh", "assess"}));
  EXPECT_EQ(names_of_run(with_prior(), options, "height"),
            (Names{"polarization", "prior", "polarizer", "zenith", "height"}));
  options.fusion = Fusion::grid;
  EXPECT_EQ(names_of_run(with_prior(), options),
            (Names{"polarization", "prior", "polarizer", "evidence", "zenith", "height", "fuse", "mesh", "assess"}));
}

TEST(StepTable, WithoutAPriorThereArePolarizationAndItsHeightOnly) {
  EXPECT_EQ(names_of_run({}, {}), (Names{"polarization", "polarizer", "evidence", "zenith", "height"}));
  EXPECT_EQ(names_of_run({}, {}, "zenith"), (Names{"polarization", "polarizer", "zenith"}));
  EXPECT_TRUE(names_of_run({}, {}, "fuse").empty());
  for (const bool all : {true, false}) {
    RunOptions run;
    if (!all) run.until = "fuse";
    expect_error(
        ErrorCode::input, [&] { reconstruct({}, {}, run, {}); }, "[prior] is missing");
  }
}

TEST(StepTable, APlanHasTheStepsOfThePhotosBeforeThePrior) {
  const auto planned = [](const PriorSource& prior, const std::optional<std::string>& until) {
    Station station;
    station.prior = prior;
    Names names;
    for (const Step* step : planned_steps(step_table(), station, {}, until)) names.push_back(step->name);
    return names;
  };
  EXPECT_EQ(planned(SweptDepth{}, "prior"), (Names{"polarization", "photos", "sweep", "prior"}));
  EXPECT_EQ(planned(SweptDepth{}, "polarization"), Names{"polarization"});
  EXPECT_EQ(planned(DepthFile{"depth.tif"}, "prior"), (Names{"polarization", "prior"}));
}

TEST(StepTable, AnUnknownStepIsNamedWithTheExistingOnes) {
  for (const char* name : {"refine", "report", "Fuse"}) {
    expect_error(
        ErrorCode::input, [&] { describe_run({}, name); }, std::string("step ") + name + " does not exist",
        "zenith, height, fuse, mesh, assess");
  }
  EXPECT_EQ(describe_run({}, "prior").back().leaves, (Names{"prior/depth.tif", "prior/sigma.tif"}));
  EXPECT_EQ(describe_run({}, "prior").back().may_leave, Names{"prior/points.png"});
}

}  // namespace
}  // namespace malus
