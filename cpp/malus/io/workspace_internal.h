#pragma once

// Private to the library: the folder in which a reconstruction leaves its results, and its record, manifest.json.

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "malus/core/context.h"

namespace malus {

/// Which steps of a station are done, from what, with which outputs. One process at a time works in it, on one station.
///
/// manifest.json, keys sorted so that two runs can be compared:
///   format    version of this layout
///   station   name, file and values of the station that the workspace belongs to
///   options   of the steps below; for sections that none of them has, of the last run
///   <info>    what else set_info recorded: versions, …
///   inputs    path → SHA-256 of every file or array that the steps below were made from
///   steps     by name: status "done", key (hash of everything the step depends on), after, inputs, options,
///             outputs (path → size, sha256), warnings, notes, and a checksum of all that
///   times     by step: what it took and when it ended; all that differs between two equal runs
class Workspace {
 public:
  using Json = nlohmann::ordered_json;

  /// The station that a workspace belongs to.
  struct Owner {
    std::string name;
    std::filesystem::path file;  ///< empty for a station made in code
    Json says = {};              ///< the station's values, for the record
  };

  /// A file that a step has written.
  struct Output {
    std::string path;  ///< below the folder
    std::uint64_t size = 0;
    std::string sha256;
  };

  /// What is known of a finished step.
  struct Record {
    std::string key;
    std::map<std::string, std::string> after;   ///< the steps whose results it uses → their keys
    std::map<std::string, std::string> inputs;  ///< path as the station gives it → SHA-256
    Json options = Json::object();              ///< those that it depends on, by section
    std::vector<Output> outputs;
    std::vector<std::string> warnings;
    Json notes = Json::object();
  };

  /// Opens the station's folder, creating it if needed, and locks it until destruction. Throws ErrorCode::input when it
  /// cannot be created or written, is in use by another process, has files but no manifest, belongs to another station
  /// or has a damaged manifest (the message says what to do); ErrorCode::resource when the disk is full. `replace` =
  /// take the workspace over from another station, and begin anew if its manifest is damaged.
  ///
  /// A station is the same if its file is, or if its name and the way from the folder to its file are (moved together).
  Workspace(const std::filesystem::path& folder, const Owner& owner, bool replace);
  /// Opens and locks a folder that is a workspace already, whoever owns it.
  explicit Workspace(const std::filesystem::path& folder);
  ~Workspace();
  Workspace(const Workspace&) = delete;
  Workspace& operator=(const Workspace&) = delete;

  const std::filesystem::path& folder() const;

  /// The record of a step that is done, or null.
  const Record* record(std::string_view step) const;
  /// Files of a step that is done which are not as they were left, by their sizes and hashes; the manifest itself if
  /// its record of the step was edited.
  std::vector<std::string> changed_since(std::string_view step, const Context& context) const;

  /// Removes files that a run which was killed had begun to write.
  void remove_unfinished() const;

  /// Removes the marks of a step and of all that came after it, then their files: those recorded, and of `leaves` what
  /// there is.
  void forget(const std::string& step, const std::vector<std::string>& leaves);
  /// What is recorded of files, by their paths below the folder. Throws ErrorCode::input if one is not there.
  std::vector<Output> examine(const std::vector<std::string>& paths, const Context& context) const;
  /// Marks the step as done; `times` says what it took. The manifest is on the disk when this returns.
  void finish(const std::string& step, Record record, Json times);
  /// Records a value under a name of its own at the top of the manifest.
  void set_info(const std::string& name, const Json& value);
  /// The same for what something else than a step took.
  void set_times(const std::string& name, const Json& times);

  /// The manifest of a folder. Throws ErrorCode::input if it has none, or one that is damaged or was edited.
  static Json read_manifest(const std::filesystem::path& folder);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace malus
