// malus-station: the whole job for a station whose camera and prior are given, without Python.

#include <CLI/CLI.hpp>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <iostream>
#include <mutex>
#include <new>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <vector>

#include "malus/core/version.h"
#include "malus/station/options.h"
#include "malus/station/presets.h"
#include "malus/station/reconstruct.h"

namespace {

using malus::Context;
using malus::ErrorCode;

std::atomic<bool> interrupted{false};
static_assert(std::atomic<bool>::is_always_lock_free, "the signal handler sets this flag");

struct Arguments {
  std::string station, workspace, fusion, preset, options_file, until, reference;
  std::vector<std::string> assignments;
  int threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  bool json = false, quiet = false, replace = false;
};

/// Shows progress: JSON lines on standard output, or one line a finished step on standard error.
class Reporter {
 public:
  explicit Reporter(const Arguments& arguments) : json_(arguments.json), quiet_(arguments.quiet) {}

  void progress(const malus::Progress& event) {
    if (json_) {
      write({{"event", "progress"}, {"step", event.step}, {"fraction", event.fraction}, {"message", event.message}});
    } else if (!quiet_ && event.fraction >= 1) {
      std::fprintf(stderr, "%-13s %s\n", event.step.c_str(), event.message.empty() ? "done" : event.message.c_str());
    }
  }

  /// How far the result may be trusted, and with --quiet the warnings that were not shown: nobody shall miss them.
  void close(const malus::Quality& quality) const {
    if (json_) return;
    const bool is_high = quality.confidence.level == malus::ConfidenceLevel::high;
    if (quiet_) {
      for (const std::string& warning : quality.warnings) std::fprintf(stderr, "warning: %s\n", warning.c_str());
      if (is_high) return;
    }
    std::fprintf(stderr, "%-13s %s\n", "confidence", std::string(enum_name(quality.confidence.level)).c_str());
    for (const std::string& reason : quality.confidence.reasons) std::fprintf(stderr, "  %s\n", reason.c_str());
  }

  void log(malus::LogLevel level, const std::string& message) {
    const bool warning = level == malus::LogLevel::warning;
    if (json_) {
      write({{"event", "log"}, {"level", warning ? "warning" : "info"}, {"message", message}});
    } else if (!quiet_ && warning) {
      std::fprintf(stderr, "warning: %s\n", message.c_str());
    }
  }

 private:
  void write(nlohmann::ordered_json event) {
    const auto elapsed = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_);
    event["seconds"] = elapsed.count();
    std::cout << event.dump() << std::endl;
  }

  bool json_, quiet_;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

malus::Options read_options(const Arguments& arguments) {
  malus::Options options = arguments.preset.empty() ? malus::Options() : malus::preset_options(arguments.preset);
  if (!arguments.options_file.empty()) options = malus::options_from_file(options, arguments.options_file);
  for (const std::string& assignment : arguments.assignments) malus::set_option(options, assignment);
  if (!arguments.fusion.empty()) malus::set_option(options, "fusion=" + arguments.fusion);
  return options;
}

void run(const Arguments& arguments) {
  Reporter reporter(arguments);
  std::mutex mutex;
  Context context;
  context.threads = arguments.threads;
  context.cancel = &interrupted;
  context.on_progress = [&](const malus::Progress& event) {
    const std::lock_guard lock(mutex);
    reporter.progress(event);
  };
  context.on_log = [&](malus::LogLevel level, const std::string& message) {
    const std::lock_guard lock(mutex);
    reporter.log(level, message);
  };
  malus::RunOptions where{.workspace = arguments.workspace, .replace = arguments.replace, .keep_maps = false};
  if (!arguments.until.empty()) where.until = arguments.until;
  if (!arguments.reference.empty()) where.reference = arguments.reference;
  const malus::Options options = read_options(arguments);
  const malus::Results results = malus::reconstruct(malus::Station::load(arguments.station), options, where, context);
  if (const auto report = results.get<malus::QualityReport>()) reporter.close(report->quality);
}

int fail(int code, const std::string& message) {
  std::fprintf(stderr, "malus-station: %s\n", message.c_str());
  return code;
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  CLI::App app{"Metric surface of a heritage object from polarized images and a coarse surface", "malus-station"};
  app.set_version_flag("--version", std::string("malus-station ") + malus::version);
  app.add_option("station", arguments.station, "station file (TOML)")->required()->type_name("STATION.toml");
  app.add_option("-o,--output", arguments.workspace, "workspace folder")->required()->type_name("WORK");
  app.add_option("--fusion", arguments.fusion, "the paper's transfer, or the refinement (default)")
      ->check(CLI::IsMember({"grid", "refined"}));
  app.add_option("--preset", arguments.preset, "start from a named set of options: paper")->type_name("NAME");
  app.add_option("--until", arguments.until, "the step to run, after those it needs")->type_name("STEP");
  app.add_option("--reference", arguments.reference, "compare with this cloud or mesh")->type_name("SCAN.ply");
  app.add_option("--set", arguments.assignments, "any option of any step")->type_name("SECTION.KEY=VALUE")->take_all();
  app.add_option("--options", arguments.options_file, "options, one table a step")->type_name("FILE.toml");
  app.add_option("--threads", arguments.threads, "default: all cores")->check(CLI::PositiveNumber);
  app.add_flag("--replace", arguments.replace, "take the workspace over if it belongs to another station");
  app.add_flag("--json", arguments.json, "one JSON object a progress event on standard output");
  app.add_flag("--quiet", arguments.quiet, "errors, warnings and a confidence that is not high only");
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& success) {
    return app.exit(success);
  } catch (const CLI::ParseError& error) {
    return fail(static_cast<int>(ErrorCode::input), error.what());
  }

  if (arguments.workspace.empty())
    return fail(static_cast<int>(ErrorCode::input), "--output is empty, expected a folder");

  std::signal(SIGINT, [](int) { interrupted.store(true); });
  std::signal(SIGTERM, [](int) { interrupted.store(true); });
  try {
    run(arguments);
  } catch (const malus::Error& error) {
    return fail(static_cast<int>(error.code()), error.what());
  } catch (const std::bad_alloc&) {
    return fail(static_cast<int>(ErrorCode::resource), "out of memory");
  } catch (const std::filesystem::filesystem_error& error) {
    return fail(static_cast<int>(ErrorCode::input), error.path1().string() + ": " + error.code().message());
  } catch (const std::exception& error) {
    return fail(static_cast<int>(ErrorCode::resource),
                std::string("stopped by an error of its own, please report it: ") + error.what());
  }
  return 0;
}
