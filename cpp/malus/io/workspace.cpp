#include "malus/io/workspace.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <ctime>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "malus/io/atomic_file.h"
#include "malus/io/input_file.h"
#include "malus/io/sha256.h"

namespace malus {
namespace {

using Json = nlohmann::json;

constexpr int manifest_format = 1;

/// Held as long as the object lives; the system drops it when the process dies.
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
  ~FolderLock() { ::close(descriptor_); }
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

/// Whether the manifest has the layout that this code writes; what is read later is not checked again.
bool is_manifest(const Json& json) {
  if (!json.is_object() || json.value("format", Json()) != manifest_format) return false;
  if (!json.value("steps", Json()).is_object() || !json.value("times", Json()).is_object()) return false;
  for (const Json& step : json.at("steps")) {
    if (!step.is_object() || !step.value("status", Json()).is_string() || !step.value("key", Json()).is_string() ||
        !step.value("outputs", Json()).is_object() || !step.contains("notes")) {
      return false;
    }
    for (const Json& output : step.at("outputs")) {
      if (!output.is_object() || !output.value("size", Json()).is_number_unsigned()) return false;
    }
  }
  return true;
}

Json read_manifest(const std::filesystem::path& path) {
  if (!std::filesystem::exists(path)) {
    return {{"format", manifest_format}, {"steps", Json::object()}, {"times", Json::object()}};
  }
  std::string text;
  if (std::filesystem::is_directory(path) || std::filesystem::file_size(path) > 0) text = read_file(path, "manifest");
  Json json = Json::parse(text, nullptr, false);
  if (!is_manifest(json)) {
    throw input_error("manifest " + path.string() +
                      " is damaged or of another version; delete it to run all steps again, or choose another folder");
  }
  return json;
}

Json parse_value(const std::string& text) {
  Json json = Json::parse(text, nullptr, false);
  if (json.is_discarded()) throw std::invalid_argument("not JSON: " + text);
  return json;
}

}  // namespace

struct Workspace::State {
  explicit State(const std::filesystem::path& path)
      : folder(path), lock((create_folder(path), path)), manifest(read_manifest(manifest_path())) {}

  std::filesystem::path manifest_path() const { return folder / "manifest.json"; }
  void save() const { write_file(manifest_path(), manifest.dump(2) + "\n"); }

  std::filesystem::path folder;
  FolderLock lock;
  Json manifest;
};

Workspace::Workspace(const std::filesystem::path& folder)
    : state_(std::make_unique<State>(std::filesystem::absolute(folder).lexically_normal())) {}

Workspace::~Workspace() = default;

const std::filesystem::path& Workspace::folder() const {
  return state_->folder;
}

bool Workspace::is_done(const std::string& step, const std::string& key) const {
  const Json& steps = state_->manifest.at("steps");
  const auto found = steps.find(step);
  if (found == steps.end() || found->at("status") != "done" || found->at("key") != key) return false;
  for (const auto& [path, output] : found->at("outputs").items()) {
    std::error_code error;
    const std::uintmax_t size = std::filesystem::file_size(state_->folder / path, error);
    if (error || size != output.at("size").get<std::uintmax_t>()) return false;
  }
  return true;
}

std::string Workspace::notes(const std::string& step) const {
  const Json& steps = state_->manifest.at("steps");
  const auto found = steps.find(step);
  return found == steps.end() ? "{}" : found->at("notes").dump();
}

void Workspace::begin(const std::string& step) {
  const bool marked = state_->manifest["steps"].erase(step) > 0;
  state_->manifest["times"].erase(step);
  if (marked || !std::filesystem::exists(state_->manifest_path())) state_->save();
}

Workspace::Output Workspace::examine(const std::string& path) const {
  const std::filesystem::path file = state_->folder / path;
  return {path, require_file(file, "output"), sha256_of_file(file, "output", AfterHash::not_read_soon)};
}

void Workspace::finish(const std::string& step, const std::string& key, const std::vector<Output>& outputs,
                       const Use& use, const std::string& notes_json) {
  Json record = {{"status", "done"}, {"key", key}, {"outputs", Json::object()}, {"notes", parse_value(notes_json)}};
  for (const Output& output : outputs)
    record["outputs"][output.path] = {{"size", output.size}, {"sha256", output.sha256}};
  state_->manifest["steps"][step] = std::move(record);
  state_->manifest["times"][step] = {
      {"seconds", use.seconds}, {"cpu_seconds", use.cpu_seconds}, {"peak_mb", use.peak_mb}, {"finished", utc_now()}};
  state_->save();
}

void Workspace::set_info(const std::string& name, const std::string& json) {
  if (name == "format" || name == "steps" || name == "times") throw std::invalid_argument("reserved name " + name);
  state_->manifest[name] = parse_value(json);
  state_->save();
}

}  // namespace malus
