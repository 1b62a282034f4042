#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

namespace malus {

/// The folder in which a reconstruction leaves its results, and its record, manifest.json: which steps are done, from
/// what, with which outputs. One process at a time works in it.
///
/// manifest.json, keys sorted so that two runs can be compared:
///   format      version of this layout
///   <info>      what set_info recorded: inputs, options, versions, …
///   steps       by name: status "done", key (hash of everything the step depends on), outputs (path → size, sha256),
///   notes times       by step: seconds, cpu_seconds (of all threads), peak_mb (of the process until then), finished
///   (UTC); all that differs between two equal runs
class Workspace {
 public:
  /// What a step took.
  struct Use {
    double seconds = 0;
    double cpu_seconds = 0;  ///< of all threads of the process
    double peak_mb = 0;      ///< most memory the process has had until then
  };

  /// A file that a step has written.
  struct Output {
    std::string path;  ///< below the folder
    std::uint64_t size = 0;
    std::string sha256;
  };

  /// Opens the folder, creating it if needed, and locks it until destruction. Throws ErrorCode::input when it cannot be
  /// created or written, is in use by another process, or its manifest is damaged (the message says what to do);
  /// ErrorCode::resource when the disk is full.
  explicit Workspace(const std::filesystem::path& folder);
  ~Workspace();
  Workspace(const Workspace&) = delete;
  Workspace& operator=(const Workspace&) = delete;

  const std::filesystem::path& folder() const;

  /// Whether the manifest has the step as done with this key and each of its outputs still has the recorded size.
  bool is_done(const std::string& step, const std::string& key) const;
  /// What `finish` recorded with a done step, JSON text; "{}" for a step that is not done.
  std::string notes(const std::string& step) const;

  /// Removes the step's mark before it is run again. Marks of steps that depend on it are the caller's business.
  void begin(const std::string& step);
  /// What is recorded of a file, by its path below the folder; from several threads at once. Throws ErrorCode::input if
  /// it is not there.
  Output examine(const std::string& path) const;
  /// Marks the step as done; `notes_json` is any JSON value. The manifest is on the disk when this returns.
  void finish(const std::string& step, const std::string& key, const std::vector<Output>& outputs, const Use& use,
              const std::string& notes_json = "{}");
  /// Records a value, JSON text, under a name of its own at the top of the manifest.
  void set_info(const std::string& name, const std::string& json);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace malus
