// malus-station: the whole reconstruction for a station whose camera and prior are given, without Python.

#include <sys/resource.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <iostream>
#include <mutex>
#include <new>
#include <string>
#include <string_view>
#include <system_error>
#include <thread>
#include <vector>

#include "malus/core/version.h"
#include "malus/station/json_fields_internal.h"
#include "malus/station/options.h"
#include "malus/station/overtaken_exports_internal.h"
#include "malus/station/presets_internal.h"
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

/// Shows progress: JSON lines on standard output, or one line per finished step on standard error.
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

  /// Reports the confidence of the surface, if there is one; with --quiet only if it is not high.
  void close(const std::optional<malus::SurfaceConfidence>& surface) {
    if (json_) return write_result(surface);
    if (!surface) return;
    const malus::SurfaceConfidence& found = *surface;
    const malus::Confidence& confidence = found.confidence;
    if (quiet_ && confidence.level == malus::ConfidenceLevel::high) return;
    std::fprintf(stderr, "%-13s %s%s\n", "confidence", std::string(enum_name(confidence.level)).c_str(),
                 found.assessed ? "" : ", not assessed yet");
    for (const std::string& reason : confidence.reasons) std::fprintf(stderr, "  %s\n", reason.c_str());
  }

  void log(malus::LogLevel level, const std::string& message) {
    const bool warning = level == malus::LogLevel::warning;
    if (warning) warnings_.push_back(message);
    if (json_) {
      write({{"event", "log"}, {"level", warning ? "warning" : "info"}, {"message", message}});
    } else if (warning) {
      std::fprintf(stderr, "warning: %s\n", message.c_str());
    }
  }

 private:
  /// The last event: `confidence` as in quality.json, null if there is no surface, and every warning of the run.
  void write_result(const std::optional<malus::SurfaceConfidence>& surface) {
    malus::Json confidence;
    if (surface) confidence = malus::fields_to_json(surface->confidence);
    write({{"event", "result"},
           {"confidence", confidence},
           {"assessed", surface && surface->assessed},
           {"warnings", warnings_}});
  }

  void write(malus::Json event) {
    const auto elapsed = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_);
    event["seconds"] = elapsed.count();
    errno = 0;
    std::cout << event.dump(-1, ' ', false, malus::Json::error_handler_t::replace) << std::endl;
    if (!std::cout && errno == EPIPE) interrupted.store(true);  // nobody reads any more
  }

  bool json_, quiet_;
  std::vector<std::string> warnings_;
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
  malus::reconstruct(malus::Station::load(arguments.station), options, where, context);
  for (const std::string& told : malus::overtaken_exports(arguments.workspace)) {
    reporter.log(malus::LogLevel::warning, told);
  }
  reporter.close(malus::surface_confidence(arguments.workspace));
}

int fail(ErrorCode code, const std::string& message) {
  std::fprintf(stderr, "malus-station: %s\n", message.c_str());
  return static_cast<int>(code);
}

/// Reports the exception that is being handled. Every error ends in an ErrorCode as exit code.
int fail_by_exception() {
  try {
    throw;
  } catch (const malus::Error& error) {
    return fail(error.code(), error.what());
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::resource, "out of memory; see `malus check` for what the station needs");
  } catch (const std::filesystem::filesystem_error& error) {
    return fail(ErrorCode::input, error.path1().string() + ": " + error.code().message());
  } catch (const std::system_error& error) {
    return fail(ErrorCode::resource, std::string("the system refuses: ") + error.what());
  } catch (const std::exception& error) {
    return fail(ErrorCode::resource, std::string("stopped by an error of its own, please report it: ") + error.what());
  } catch (...) {
    return fail(ErrorCode::resource, "stopped by an error of its own, please report it: of an unknown kind");
  }
}

/// Last resort for exceptions that leave a library's thread, or that are thrown while another one is handled.
[[noreturn]] void end_unexpectedly() {
  std::_Exit(std::current_exception() ? fail_by_exception()
                                      : fail(ErrorCode::resource, "stopped by an error of its own, please report it"));
}

/// Seconds that a run has to end after a signal. Long computations check for a signal every half second; a step that
/// writes a large file to a slow disk takes longer.
constexpr unsigned seconds_to_end = 30;

void end_at_signals() {
  const auto interrupt = [](int) {
    interrupted.store(true);
    ::alarm(seconds_to_end);
  };
  std::signal(SIGINT, interrupt);
  std::signal(SIGTERM, interrupt);
  // Sent when the shell closes. If it is ignored already (nohup), the run continues.
  if (std::signal(SIGHUP, interrupt) == SIG_IGN) std::signal(SIGHUP, SIG_IGN);
  std::signal(SIGALRM, [](int) {
    constexpr std::string_view message = "malus-station: did not end by itself; finished steps are kept\n";
    static_cast<void>(!::write(STDERR_FILENO, message.data(), message.size()));
    std::_Exit(static_cast<int>(ErrorCode::interrupted));
  });
  // A file that exceeds the size limit is then an error like a full disk, and output that nobody reads fails.
  std::signal(SIGXFSZ, SIG_IGN);
  std::signal(SIGPIPE, SIG_IGN);
}

/// Sets OPENBLAS_NUM_THREADS and starts the program once more. OpenBLAS starts its threads when it is loaded, before
/// main, and reads the variable only then. Each thread takes 128 MB; with a memory limit the threads wait for memory
/// forever, also at exit.
void start_without_blas_threads(char** arguments) {
  if (std::getenv("OPENBLAS_NUM_THREADS") != nullptr) return;
  ::setenv("OPENBLAS_NUM_THREADS", "1", 0);
  ::execv("/proc/self/exe", arguments);
  // Without /proc the program continues with those threads.
}

/// Runs before the constructors of the libraries, which report no reason when memory is missing.
void require_memory_to_start(int, char**, char**) {
  constexpr rlim_t least_bytes = rlim_t{256} << 20;
  rlimit limit{};
  if (::getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur >= least_bytes) return;
  constexpr std::string_view message =
      "malus-station: out of memory: the limit of address space (ulimit -v) is below 256 MB, which it takes to start\n";
  static_cast<void>(!::write(STDERR_FILENO, message.data(), message.size()));
  ::_exit(static_cast<int>(ErrorCode::resource));
}

[[gnu::section(".preinit_array"), gnu::used]] void (*const first_of_all)(int, char**, char**) = require_memory_to_start;

/// The steps that --until may name.
std::string listed_steps() {
  std::string list;
  for (const malus::StepDescription& step : malus::describe_run({}, {})) list += (list.empty() ? "" : ", ") + step.name;
  return list;
}

}  // namespace

int main(int argc, char** argv) {
  start_without_blas_threads(argv);
  std::set_terminate(end_unexpectedly);
  Arguments arguments;
  CLI::App app{"Metric surface of a heritage object from polarized images and a coarse surface", "malus-station"};
  app.set_version_flag("--version", std::string("malus-station ") + malus::version);
  app.add_option("station", arguments.station, "station file (TOML)")->required()->type_name("STATION.toml");
  app.add_option("-o,--output", arguments.workspace, "workspace folder")->required()->type_name("WORK");
  app.add_option("--fusion", arguments.fusion,
                 "grid = the method of the paper: faster, coarser; refined = nonlinear refinement (default)")
      ->check(CLI::IsMember({"grid", "refined"}));
  app.add_option("--preset", arguments.preset, "start from a named set of options: paper")->type_name("NAME");
  app.add_option("--until", arguments.until,
                 "last step to run (" + listed_steps() + "); the steps that it needs run first")
      ->type_name("STEP");
  app.add_option("--reference", arguments.reference,
                 "compare with this cloud or mesh (PLY or text; LAS and E57: malus)")
      ->type_name("SCAN.ply");
  app.add_option("--set", arguments.assignments, "set an option of any step; can be repeated")
      ->type_name("SECTION.KEY=VALUE")
      ->take_all()
      ->allow_extra_args(false);
  app.add_option("--options", arguments.options_file, "file with options, one table per step")->type_name("FILE.toml");
  app.add_option("--threads", arguments.threads, "number of threads; default: all cores")->check(CLI::PositiveNumber);
  app.add_flag("--replace", arguments.replace,
               "take the workspace over if it belongs to another station; its results are removed");
  app.add_flag("--json", arguments.json, "write progress to standard output, one JSON object per event");
  app.add_flag("--quiet", arguments.quiet, "print only errors, warnings, and a confidence that is not high");
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& success) {
    return app.exit(success);
  } catch (const CLI::ParseError& error) {
    return fail(ErrorCode::input, error.what());
  }

  if (arguments.workspace.empty()) return fail(ErrorCode::input, "--output is empty, expected a folder");
  end_at_signals();
  try {
    run(arguments);
  } catch (...) {
    return fail_by_exception();
  }
}
