// Runs a small table of test steps: the runner's behavior depends only on the rows of its table.

#include <fstream>
#include <set>

#include "io/temporary_folder.h"
#include "malus/core/version.h"
#include "malus/io/input_file_internal.h"
#include "malus/io/sha256_internal.h"
#include "malus/station/step_runner_internal.h"
#include "thrown_error.h"

namespace malus {

/// Results of the steps in the table. results_read_back counts how often each is read back.
struct Seed {
  Image<float> map;
  double value = 0;
};
struct Twice {
  double value = 0;
};
struct Sum {
  double value = 0;
  std::vector<std::string> warnings;
};

std::multiset<std::string> results_read_back;

void keep(Seed& result, Keeper& keeper) {
  if (keeper.is_reading()) results_read_back.insert("seed");
  keeper.raster("seed/map.tif", result.map);
  keeper.value("value", result.value);
}
void keep(Twice& result, Keeper& keeper) {
  if (keeper.is_reading()) results_read_back.insert("twice");
  keeper.value("twice", result.value);
  keeper.extra("twice.txt", std::to_string(result.value));
}
void keep(Sum& result, Keeper& keeper) {
  keeper.value("value", result.value);
  keeper.value("all", result.warnings);
  keeper.extra("sum.txt", std::to_string(result.value));
}

namespace {

std::function<void()> while_reading;

Seed make_seed(const Job& job) {
  const std::filesystem::path& file = job.station.file.polarized.images[0];
  Seed seed{Image<float>({2, 1}), std::stod(read_file(file, "seed"))};
  seed.map(1, 0) = static_cast<float>(seed.value);
  if (while_reading) while_reading();
  if (seed.value < 0) job.context.log(LogLevel::warning, "the seed is below zero");
  return seed;
}

Twice double_seed(const Job& job, const Seed& seed) {
  if (job.options.grid.grid_px == 7) job.context.log(LogLevel::warning, "seven");
  job.context.log(LogLevel::info, "nothing to worry about");
  return {2 * seed.value};
}

void write_side(const Job& job, const Seed& seed) {
  job.files.add("side.txt", 1, [&seed](const std::filesystem::path& file) {
    std::ofstream(file) << seed.map(1, 0);
    return true;
  });
  job.files.add("never.txt", 1, [](const std::filesystem::path&) { return false; });
}

Sum add_up(const Job&, const Seed& seed, const Twice* twice, const Warnings& warnings) {
  return {seed.value + (twice != nullptr ? twice->value : 0), warnings.all};
}

const std::vector<Step>& table() {
  static const std::vector<Step> steps{
      step({.name = "seed", .station = {&StationInputs::polarized}, .leaves = {"seed/map.tif"}}, make_seed),
      step({.name = "twice",
            .options = {"grid"},
            .leaves = {"twice.txt"},
            .on_its_own = [](const Options& options) { return options.assess.polarization_height; }},
           double_seed),
      step({.name = "side", .leaves = {"side.txt"}, .may_leave = {"never.txt"}}, write_side),
      step({.name = "sum", .options = {"assess"}, .leaves = {"sum.txt"}}, add_up),
      step_by_python<Sum>({.name = "page", .leaves = {"page.html"}}),
  };
  return steps;
}

class StepRunnerTest : public testing::Test {
 protected:
  StepRunnerTest() {
    station_.file.name = "toy";
    station_.file.path = folder_.write("station.toml", "x");
    station_.file.polarized.images = {folder_.write("seed.txt", "3")};
    run_.workspace = work_;
    context_.threads = 2;
    context_.on_progress = [this](const Progress& event) {
      if (event.fraction < 1) return;
      (event.message.empty() ? ran_ : kept_).push_back(event.step);
    };
    context_.on_log = [this](LogLevel level, const std::string& text) {
      if (level == LogLevel::warning) logged_.push_back(text);
    };
    while_reading = nullptr;
  }

  Results run(const std::optional<std::string>& until = std::nullopt, const StepRunner::Closing& closing = {}) {
    ran_.clear();
    kept_.clear();
    logged_.clear();
    results_read_back.clear();
    return StepRunner(table(), steps_of_run(table(), station_, options_, until), station_, options_, run_, context_)
        .run(closing);
  }
  Workspace::Json manifest() const { return Workspace::read_manifest(work_); }
  bool exists(const char* name) const { return std::filesystem::exists(work_ / name); }

  using Names = std::vector<std::string>;
  TemporaryFolder folder_;
  const std::filesystem::path work_ = folder_ / "work";
  Station station_;
  Options options_;
  RunOptions run_;
  Context context_;
  Names ran_, kept_, logged_;
};

TEST_F(StepRunnerTest, RunsStepsOnceAndReadsBackRequestedResults) {
  const Results first = run();
  EXPECT_EQ(ran_, (Names{"seed", "twice", "side", "sum"}));
  EXPECT_EQ(first.get<Sum>()->value, 9);
  EXPECT_TRUE(exists("side.txt"));
  EXPECT_FALSE(exists("never.txt"));

  const Results second = run();
  EXPECT_EQ(kept_, (Names{"seed", "twice", "side", "sum"}));
  EXPECT_TRUE(ran_.empty());
  EXPECT_EQ(second.get<Seed>()->map, first.get<Seed>()->map);
  EXPECT_EQ(second.get<Sum>()->value, 9);

  run_.keep_maps = false;
  const Results lean = run();
  EXPECT_TRUE(results_read_back.empty()) << "only the last step's result is needed, and it is not counted";
  EXPECT_EQ(lean.get<Sum>()->value, 9);
  EXPECT_EQ(lean.get<Seed>(), nullptr);

  options_.assess.histogram_bins = 7;
  run();
  EXPECT_EQ(ran_, Names{"sum"});
  EXPECT_EQ(results_read_back, (std::multiset<std::string>{"seed", "twice"}))
      << "each is read back once, for the step that reads it";
}

TEST_F(StepRunnerTest, RepeatsStepsThatDependOnAChange) {
  run();
  options_.grid.grid_px = 11;
  run();
  EXPECT_EQ(kept_, (Names{"seed", "side"}));
  EXPECT_EQ(ran_, (Names{"twice", "sum"}));
  folder_.write("seed.txt", "4");
  EXPECT_EQ(run().get<Sum>()->value, 12);
  EXPECT_EQ(ran_.size(), 4u);
}

TEST_F(StepRunnerTest, LaterStepsAreForgottenWithTheirFiles) {
  run();
  folder_.write("work/page.html", "page");
  {
    Workspace workspace(work_);
    Workspace::Record record;
    record.after = {{"sum", "key"}};
    record.outputs = workspace.examine({"page.html"}, {});
    workspace.finish("page", record, {});
  }
  folder_.write("seed.txt", "4");
  run("twice");
  EXPECT_EQ(ran_, (Names{"seed", "twice"}));
  EXPECT_EQ(manifest()["steps"].size(), 2u);
  for (const char* stale : {"side.txt", "sum.txt", "page.html"}) EXPECT_FALSE(exists(stale)) << stale;
  EXPECT_TRUE(exists("twice.txt"));
}

TEST_F(StepRunnerTest, AFailedRunLeavesNoFinishedStep) {
  run();
  folder_.write("seed.txt", "not a number");
  EXPECT_ANY_THROW(run());
  EXPECT_TRUE(manifest()["steps"].empty());
  EXPECT_FALSE(exists("sum.txt"));
  EXPECT_FALSE(exists("seed/map.tif"));
}

TEST_F(StepRunnerTest, WarningsAreRecordedRepeatedAndReadByTheLastStep) {
  folder_.write("seed.txt", "-1");
  options_.grid.grid_px = 7;
  station_.photogrammetry = Photogrammetry{"{}", R"({"photos": {"seconds": 5}})", {"photos: blurred"}};
  const Names expected{"photos: blurred", "seed: the seed is below zero", "twice: seven"};
  EXPECT_EQ(run().get<Sum>()->warnings, expected);
  EXPECT_EQ(logged_, (Names{"the seed is below zero", "seven"}));
  EXPECT_EQ(manifest()["steps"]["seed"]["warnings"], Workspace::Json({"the seed is below zero"}));
  EXPECT_EQ(manifest()["warnings"], Workspace::Json(expected));
  EXPECT_EQ(manifest()["times"]["photos"]["seconds"], 5);

  EXPECT_EQ(run().get<Sum>()->warnings, expected);
  EXPECT_TRUE(ran_.empty());
  EXPECT_EQ(logged_, (Names{"the seed is below zero", "seven"})) << "warnings of kept steps are repeated";
  station_.photogrammetry->warnings.clear();
  run();
  EXPECT_EQ(ran_, Names{"sum"}) << "the sum step reads the warnings";
}

TEST_F(StepRunnerTest, AChangedFileIsReportedAndMadeAgain) {
  run();
  const std::string before = read_file(work_ / "seed/map.tif", "map");
  std::string flipped = before;
  flipped[flipped.size() / 2] ^= 1;
  folder_.write("work/seed/map.tif", flipped);
  run();
  EXPECT_EQ(ran_.size(), 4u);
  ASSERT_EQ(logged_.size(), 1u);
  EXPECT_NE(logged_[0].find("map.tif is not as the step seed left it"), std::string::npos) << logged_[0];
  EXPECT_EQ(read_file(work_ / "seed/map.tif", "map"), before);
  EXPECT_TRUE(manifest()["warnings"].empty()) << "a changed file is no warning about the result";

  nlohmann::json edited = nlohmann::json::parse(read_file(work_ / "manifest.json", "manifest"));
  edited["steps"]["twice"]["notes"]["twice"] = 1000;
  folder_.write("work/manifest.json", edited.dump());
  EXPECT_EQ(run().get<Sum>()->value, 9);
  EXPECT_EQ(ran_, (Names{"twice", "sum"}));
}

TEST_F(StepRunnerTest, AnInputThatChangesWhileItIsReadLeavesNothing) {
  while_reading = [this] { folder_.write("seed.txt", "5"); };
  expect_error(
      ErrorCode::input, [this] { run(); }, "seed.txt", "was changed while it was read");
  EXPECT_TRUE(manifest()["steps"].empty());
  while_reading = nullptr;
  EXPECT_EQ(run().get<Seed>()->value, 5);
}

TEST_F(StepRunnerTest, OptionalFilesOfAnEarlierRunAreRemoved) {
  run();
  folder_.write("work/never.txt", "left by another version");
  folder_.write("seed.txt", "4");
  run();
  EXPECT_FALSE(exists("never.txt")) << "optional files of a step are removed before the step is run";
}

TEST_F(StepRunnerTest, OptionalResultsAreReadIfTheRunHasThem) {
  options_.assess.polarization_height = false;
  EXPECT_EQ(run().get<Sum>()->value, 3);
  EXPECT_EQ(ran_, (Names{"seed", "side", "sum"}));
  EXPECT_FALSE(exists("twice.txt"));
  run("twice");
  EXPECT_EQ(ran_, Names{"twice"});
}

TEST_F(StepRunnerTest, ARunInMemoryWritesNothingAndUsesKnownResults) {
  run_.workspace.reset();
  const Results first = run("twice");
  EXPECT_EQ(ran_, (Names{"seed", "twice"}));
  EXPECT_FALSE(std::filesystem::exists(work_));
  run_.known = &first;
  options_.grid.grid_px = 11;
  const Results second = run();
  EXPECT_EQ(kept_, Names{"seed"});
  EXPECT_EQ(ran_, (Names{"twice", "sum"}));
  EXPECT_EQ(second.get<Seed>(), first.get<Seed>()) << "shared, not copied";
}

TEST_F(StepRunnerTest, ResultsInMemoryAreWrittenWithTheirWarnings) {
  folder_.write("seed.txt", "-3");
  run_.workspace.reset();
  const Results first = run();
  EXPECT_EQ(first.warnings, Names{"seed: the seed is below zero"});
  run_.workspace = work_;
  run_.known = &first;
  bool made_again = false;
  while_reading = [&] { made_again = true; };
  const Results second = run();
  EXPECT_FALSE(made_again);
  EXPECT_EQ(second.get<Seed>(), first.get<Seed>());
  EXPECT_EQ(second.warnings, first.warnings);
  EXPECT_EQ(logged_, Names{"the seed is below zero"});
  EXPECT_TRUE(exists("side.txt")) << "files of a step without a result are made";
  run_.known = nullptr;
  run();
  EXPECT_EQ(kept_, (Names{"seed", "twice", "side", "sum"}));
  EXPECT_EQ(logged_, Names{"the seed is below zero"}) << "the warning is recorded with its step";
}

TEST_F(StepRunnerTest, ResultsAreReleasedOnceNoLaterStepReadsThem) {
  struct Steps {
    static Seed first(const Job&) { return {Image<float>({1, 1}), 1}; }
    static Twice second(const Job&, const Seed&) { return {2}; }
    static Sum third(const Job&, const Twice&) { return {3, {}}; }
  };
  const std::vector<Step> steps{step({.name = "first", .leaves = {"seed/map.tif"}}, Steps::first),
                                step({.name = "second", .leaves = {"twice.txt"}}, Steps::second),
                                step({.name = "third", .leaves = {"sum.txt"}}, Steps::third)};
  std::vector<Step> watched = steps;
  std::weak_ptr<const void> seed;
  bool alive = true;
  watched[1].run = [&](const Job& job, const StepInputs& inputs) {
    seed = inputs.at(typeid(Seed));
    return steps[1].run(job, inputs);
  };
  watched[2].run = [&](const Job& job, const StepInputs& inputs) {
    alive = !seed.expired();
    return steps[2].run(job, inputs);
  };
  for (const bool keep_maps : {true, false}) {
    run_.workspace.reset();
    run_.keep_maps = keep_maps;
    const Results results =
        StepRunner(watched, steps_of_run(watched, station_, options_, {}), station_, options_, run_, context_).run();
    EXPECT_EQ(alive, keep_maps);
    EXPECT_EQ(results.get<Twice>() != nullptr, keep_maps);
    EXPECT_NE(results.get<Sum>(), nullptr);
  }
}

TEST_F(StepRunnerTest, EveryRunRepeatsWarningsAboutTheStation) {
  station_.file.scale_bars.emplace_back().distance = 10;
  station_.file.scale_errors = {1};
  const Names said{"[[scale]] 1: 10 mm known, off by 1 mm"}, prefixed{"station: " + said[0]};
  const Results first = run();
  EXPECT_EQ(logged_, said);
  EXPECT_EQ(first.warnings, prefixed);
  EXPECT_EQ(first.get<Sum>()->warnings, prefixed);
  EXPECT_EQ(run().warnings, prefixed);
  EXPECT_EQ(logged_, said) << "warnings about the station are repeated though every step is kept";

  station_.file.scale_errors = {0.01};
  const Results mended = run();
  EXPECT_TRUE(mended.warnings.empty());
  EXPECT_EQ(ran_, Names{"sum"}) << "the sum step reads the warnings";
}

TEST_F(StepRunnerTest, AWarningOfTheRunIsKeptWithoutAStep) {
  const StepRunner::Closing closing = [](const Results& results) {
    return std::optional("twice is " + std::to_string(static_cast<int>(results.get<Twice>()->value)));
  };
  const Names said{"twice is 6"}, prefixed{"run: " + said[0]};
  for (const bool keep_maps : {true, false}) {
    run_.keep_maps = keep_maps;
    const Results results = run("twice", closing);
    EXPECT_EQ(logged_, said);
    EXPECT_EQ(results.warnings, prefixed) << "also if every step is kept";
    EXPECT_EQ(manifest()["warnings"], Workspace::Json(prefixed));
    EXPECT_TRUE(manifest()["steps"]["twice"]["warnings"].empty());
  }
  EXPECT_TRUE(run().warnings.empty());
  EXPECT_TRUE(manifest()["warnings"].empty());

  run_.workspace.reset();
  run_.keep_maps = true;
  const Results in_memory = run("twice", closing);
  run_.known = &in_memory;
  EXPECT_EQ(run("twice", closing).warnings, prefixed) << "once, though the earlier run gave it, too";
}

TEST_F(StepRunnerTest, TheManifestRecordsTimeAndMemoryOfEveryStep) {
  run();
  for (const char* name : {"seed", "twice", "side", "sum"}) {
    const Workspace::Json times = manifest()["times"][name];
    EXPECT_GE(times["seconds"].get<double>(), 0) << name;
    EXPECT_GE(times["cpu_seconds"].get<double>(), 0) << name;
    EXPECT_GT(times["peak_mb"].get<double>(), 1) << name;
  }
  EXPECT_EQ(manifest()["inputs"]["seed.txt"], sha256_of_bytes("3"));
  EXPECT_EQ(manifest()["station"]["says"]["sha256"], sha256_of_bytes("x"));
  EXPECT_EQ(manifest()["versions"]["malus"], version);
}

TEST_F(StepRunnerTest, AFileMissingInTheTableIsAnError) {
  std::vector<Step> wrong = table();
  wrong[0].leaves = {"other.tif"};
  EXPECT_THROW(
      StepRunner(wrong, steps_of_run(wrong, station_, options_, "seed"), station_, options_, run_, context_).run(),
      std::logic_error);
}

}  // namespace
}  // namespace malus
