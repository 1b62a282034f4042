#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <ctime>
#include <stdexcept>

#include "malus/core/parallel_internal.h"
#include "malus/io/atomic_file_internal.h"
#include "malus/io/input_file_internal.h"
#include "malus/io/sha256_internal.h"
#include "malus/io/workspace_internal.h"

namespace malus {
namespace {

namespace fs = std::filesystem;
using Json = Workspace::Json;
/// JSON with sorted keys.
using SortedJson = nlohmann::json;

constexpr int manifest_format = 2;
constexpr int deepest_level = 100;
constexpr std::array<std::string_view, 5> reserved_names{"format", "inputs", "station", "steps", "times"};

/// Lock on the folder while the object lives; the system releases it when the process dies.
class FolderLock {
 public:
  explicit FolderLock(const std::filesystem::path& folder) {
    const std::filesystem::path path = folder / ".lock";
    descriptor_ = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    if (descriptor_ < 0) throw file_error("cannot write", path, errno);
    if (::flock(descriptor_, LOCK_EX | LOCK_NB) != 0) {
      const int error_number = errno;
      ::close(descriptor_);
      if (error_number != EWOULDBLOCK) throw file_error("cannot lock", path, error_number);
      throw input_error("workspace " + folder.string() +
                        " is in use by another run; wait for it, or choose another folder");
    }
  }
  ~FolderLock() {
    // Closing alone leaves the folder locked while a child that was forked meanwhile has the file open, too.
    ::flock(descriptor_, LOCK_UN);
    ::close(descriptor_);
  }
  FolderLock(const FolderLock&) = delete;
  FolderLock& operator=(const FolderLock&) = delete;

 private:
  int descriptor_ = -1;
};

std::string utc_now() {
  const std::time_t now = std::chrono::system_clock::to_time_t(std::chrono::system_clock::now());
  std::tm parts{};
  ::gmtime_r(&now, &parts);
  std::array<char, 32> text{};
  std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%SZ", &parts);
  return text.data();
}

/// Whether a path of the manifest stays below the folder, so that a damaged manifest cannot delete other files.
bool stays_below(const fs::path& path) {
  return path.is_relative() && !path.empty() && *path.lexically_normal().begin() != "..";
}

/// A step's record, and its checksum in the manifest.
struct Entry {
  Workspace::Record record;
  std::string checksum;

  SortedJson json() const {
    SortedJson json = {{"status", "done"},
                       {"key", record.key},
                       {"after", record.after},
                       {"inputs", record.inputs},
                       {"options", record.options},
                       {"outputs", SortedJson::object()},
                       {"warnings", record.warnings},
                       {"notes", record.notes}};
    for (const Workspace::Output& output : record.outputs)
      json["outputs"][output.path] = {{"size", output.size}, {"sha256", output.sha256}};
    return json;
  }
  bool is_intact() const { return sha256_of_bytes(json().dump()) == checksum; }

  static Entry from_json(const SortedJson& json) {
    Entry entry{{json.at("key"),
                 json.at("after"),
                 json.at("inputs"),
                 Json(json.at("options")),
                 {},
                 json.at("warnings"),
                 Json(json.at("notes"))},
                json.at("checksum")};
    for (const auto& [path, output] : json.at("outputs").items()) {
      if (!stays_below(path)) throw std::invalid_argument(path);
      entry.record.outputs.push_back({path, output.at("size").get<std::uint64_t>(), output.at("sha256")});
    }
    return entry;
  }
};

/// Stops the parser at a depth that no manifest has, because copying a document recurses once per level.
bool require_shallow(int depth, SortedJson::parse_event_t, SortedJson&) {
  if (depth > deepest_level) throw std::invalid_argument("depth");
  return true;
}

struct Manifest {
  SortedJson info = SortedJson::object(), station;
  std::map<std::string, Entry, std::less<>> steps;
  std::map<std::string, SortedJson> times;

  SortedJson json() const {
    SortedJson json = info;
    json["format"] = manifest_format;
    json["station"] = station;
    json["times"] = times;
    json["inputs"] = json["steps"] = SortedJson::object();
    for (const auto& [name, entry] : steps) {
      json["steps"][name] = entry.json();
      json["steps"][name]["checksum"] = entry.checksum;
      json["inputs"].update(entry.record.inputs);
      json["options"].update(SortedJson(entry.record.options));
    }
    return json;
  }

  static Manifest from_json(const SortedJson& json) {
    Manifest manifest;
    if (json.at("format") != manifest_format) throw std::invalid_argument("format");
    for (const auto& [name, step] : json.at("steps").items()) manifest.steps[name] = Entry::from_json(step);
    manifest.station = json.at("station");
    manifest.times = json.at("times").get<std::map<std::string, SortedJson>>();
    for (const auto& [name, value] : json.items()) {
      if (std::ranges::find(reserved_names, name) == reserved_names.end()) manifest.info[name] = value;
    }
    return manifest;
  }

  static Manifest read(const fs::path& path) {
    const auto damaged = [&] {
      return input_error("manifest " + path.string() +
                         " is damaged or of another version; begin anew with --replace, or choose another folder");
    };
    if (fs::is_regular_file(path) && fs::is_empty(path)) throw damaged();
    try {
      return from_json(SortedJson::parse(read_file(path, "manifest"), require_shallow));
    } catch (const SortedJson::exception&) {
      throw damaged();
    } catch (const std::invalid_argument&) {
      throw damaged();
    }
  }
};

/// Whether the folder holds anything besides hidden files, such as those that file managers leave.
bool has_files(const fs::path& folder) {
  return std::ranges::any_of(fs::directory_iterator(folder), [](const fs::directory_entry& entry) {
    return !entry.path().filename().string().starts_with(".");
  });
}

/// Whether a manifest.json belongs to something else: IIIF, web pages and archives have one, too. A manifest that is
/// empty or unreadable may be a damaged one of a run.
bool is_of_something_else(const fs::path& manifest) {
  try {
    const SortedJson json = SortedJson::parse(read_file(manifest, "manifest"), require_shallow);
    return json.is_object() && !json.empty() && !json.contains("format") && !json.contains("steps");
  } catch (const std::exception&) {
    return false;
  }
}

SortedJson to_json(const Workspace::Owner& owner, const fs::path& folder) {
  const bool in_code = owner.file.empty();
  return {{"name", owner.name},
          {"says", owner.says},
          {"file", in_code ? SortedJson() : SortedJson(owner.file.string())},
          {"file_from_here", in_code ? SortedJson() : SortedJson(owner.file.lexically_proximate(folder).string())}};
}

bool is_same_station(const SortedJson& one, const SortedJson& other) {
  const auto agree = [&](const char* field) { return one.value(field, SortedJson()) == other.at(field); };
  return (agree("file") && !other.at("file").is_null()) || (agree("name") && agree("file_from_here"));
}

}  // namespace

struct Workspace::State {
  explicit State(const fs::path& path) : folder(path), lock((create_folder(path), path)) {}

  fs::path manifest_path() const { return folder / "manifest.json"; }
  void save() const { write_file(manifest_path(), manifest.json().dump(2) + "\n"); }

  fs::path folder;
  FolderLock lock;
  Manifest manifest;
};

Workspace::Workspace(const fs::path& given_folder, const Owner& owner, bool replace) {
  const fs::path folder = fs::absolute(given_folder).lexically_normal();
  const bool exists = fs::exists(folder / "manifest.json") && !is_of_something_else(folder / "manifest.json");
  if (!exists && fs::is_directory(folder) && has_files(folder)) {
    throw input_error("folder " + folder.string() +
                      " is not empty and not a workspace, expected a new or an empty one" + ", such as " +
                      (folder / "work").string());
  }
  state_ = std::make_unique<State>(folder);
  remove_unfinished();
  Manifest& manifest = state_->manifest;
  if (exists) {
    try {
      manifest = Manifest::read(state_->manifest_path());
    } catch (const Error&) {
      if (!replace) throw;
    }
  }
  const SortedJson station = to_json(owner, folder);
  if (!manifest.station.is_null() && !replace && !is_same_station(manifest.station, station)) {
    const SortedJson& file = manifest.station["file"];
    throw input_error("workspace " + folder.string() + " belongs to station " + manifest.station["name"].dump() +
                      (file.is_string() ? " of " + file.get<std::string>() : "") +
                      "; choose another folder, or take this one over with --replace");
  }
  if (manifest.station == station) return;
  manifest.station = station;
  state_->save();
}

Workspace::Workspace(const fs::path& folder) {
  if (!fs::exists(folder / "manifest.json")) {
    throw input_error((folder / "manifest.json").string() + ": there is none; this is not a workspace of malus");
  }
  state_ = std::make_unique<State>(fs::absolute(folder).lexically_normal());
  state_->manifest = Manifest::read(state_->manifest_path());
}

Workspace::~Workspace() = default;

const fs::path& Workspace::folder() const {
  return state_->folder;
}

const Workspace::Record* Workspace::record(std::string_view step) const {
  const auto found = state_->manifest.steps.find(step);
  return found == state_->manifest.steps.end() ? nullptr : &found->second.record;
}

std::vector<std::string> Workspace::changed_since(std::string_view step, const Context& context) const {
  const Entry& entry = state_->manifest.steps.find(step)->second;
  if (!entry.is_intact()) return {"manifest.json"};
  const std::vector<Output>& outputs = entry.record.outputs;
  std::vector<char> changed(outputs.size());
  parallel_for(context, outputs.size(), 1, [&](std::size_t k, std::size_t) {
    std::error_code error;
    const fs::path file = state_->folder / outputs[k].path;
    changed[k] =
        fs::file_size(file, error) != outputs[k].size || error || sha256_of_file(file, "output") != outputs[k].sha256;
  });
  std::vector<std::string> paths;
  for (std::size_t k = 0; k < outputs.size(); ++k) {
    if (changed[k] != 0) paths.push_back(outputs[k].path);
  }
  return paths;
}

void Workspace::remove_unfinished() const {
  std::error_code error, ignored;
  constexpr auto options = fs::directory_options::skip_permission_denied;
  for (fs::recursive_directory_iterator entry(state_->folder, options, error), end; !error && entry != end;
       entry.increment(error)) {
    if (is_unfinished(entry->path())) fs::remove(entry->path(), ignored);
  }
}

void Workspace::forget(const std::string& step, const std::vector<std::string>& leaves) {
  std::vector<std::string> steps{step}, files = leaves;
  for (std::size_t k = 0; k < steps.size(); ++k) {
    for (const auto& [name, entry] : state_->manifest.steps) {
      if (entry.record.after.contains(steps[k]) && std::ranges::find(steps, name) == steps.end()) steps.push_back(name);
    }
  }
  for (const std::string& name : steps) {
    const Record* known = record(name);
    if (known == nullptr) continue;
    for (const Output& output : known->outputs) files.push_back(output.path);
    state_->manifest.steps.erase(name);
    state_->manifest.times.erase(name);
  }
  // First the records: a step recorded as done must never lack its files.
  state_->save();
  for (const std::string& file : files) {
    std::error_code error;
    fs::remove(state_->folder / file, error);
    if (error) throw file_error("cannot remove", state_->folder / file, error.value());
  }
}

std::vector<Workspace::Output> Workspace::examine(const std::vector<std::string>& paths, const Context& context) const {
  std::vector<Output> outputs(paths.size());
  parallel_for(context, paths.size(), 1, [&](std::size_t k, std::size_t) {
    const fs::path file = state_->folder / paths[k];
    outputs[k] = {paths[k], require_file(file, "output"), sha256_of_file(file, "output")};
  });
  std::ranges::sort(outputs, {}, &Output::path);
  return outputs;
}

void Workspace::finish(const std::string& step, Record record, Json times) {
  Entry entry{std::move(record), {}};
  entry.checksum = sha256_of_bytes(entry.json().dump());
  state_->manifest.steps[step] = std::move(entry);
  times["finished"] = utc_now();
  set_times(step, times);
}

void Workspace::set_info(const std::string& name, const Json& value) {
  if (std::ranges::find(reserved_names, name) != reserved_names.end()) {
    throw std::invalid_argument("reserved name " + name);
  }
  state_->manifest.info[name] = value;
  state_->save();
}

void Workspace::set_times(const std::string& name, const Json& times) {
  state_->manifest.times[name] = times;
  state_->save();
}

Workspace::Json Workspace::read_manifest(const fs::path& folder) {
  const fs::path path = folder / "manifest.json";
  if (!fs::exists(path)) throw input_error(path.string() + ": there is none; this is not a workspace of malus");
  const Manifest manifest = Manifest::read(path);
  for (const auto& [name, entry] : manifest.steps) {
    if (entry.is_intact()) continue;
    throw input_error(path.string() + ": what it says of the step " + name +
                      " was changed after the step; run the station again");
  }
  return manifest.json();
}

}  // namespace malus
