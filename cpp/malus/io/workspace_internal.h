#pragma once

// Private to the library: the folder with a reconstruction's results and its record, manifest.json.

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

/// Record of a station's finished steps, with their inputs and outputs. One process at a time works in a workspace, on
/// one station.
///
/// manifest.json, keys sorted so that two runs can be compared:
///   format    version of this layout
///   station   name, file and values of the station that the workspace belongs to
///   options   of the steps below; sections that none of these steps has are the last run's
///   <info>    further values from set_info: versions, …
///   inputs    path → SHA-256 of every file or array that the steps below were made from
///   steps     by name: status "done", key (hash of everything the step depends on), after, inputs, options,
///             outputs (path → size, sha256), warnings, notes, and a checksum of all these
///   times     by step: time used and when it ended; only this differs between two equal runs
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

  /// Record of a finished step.
  struct Record {
    std::string key;
    std::map<std::string, std::string> after;   ///< the steps whose results it uses → their keys
    std::map<std::string, std::string> inputs;  ///< path as the station gives it → SHA-256
    Json options = Json::object();              ///< the options that the step depends on, by section
    std::vector<Output> outputs;
    std::vector<std::string> warnings;
    Json notes = Json::object();
  };

  /// Opens the station's folder, creating it if needed, and locks it until destruction. Throws ErrorCode::input when it
  /// cannot be created or written, is used by another process, has files but no manifest, belongs to another station or
  /// has a damaged manifest (the message states what to do); ErrorCode::resource when the disk is full. `replace` =
  /// take the workspace over from another station, and begin anew if its manifest is damaged.
  ///
  /// Two stations are the same if their files are the same, or if both their names and the relative paths from the
  /// folder to the file are (folder and file moved together).
  Workspace(const std::filesystem::path& folder, const Owner& owner, bool replace);
  /// Opens and locks a folder that is already a workspace, of any station.
  explicit Workspace(const std::filesystem::path& folder);
  ~Workspace();
  Workspace(const Workspace&) = delete;
  Workspace& operator=(const Workspace&) = delete;

  const std::filesystem::path& folder() const;

  /// The record of a step that is done, or null.
  const Record* record(std::string_view step) const;
  /// Output files of a finished step whose size or hash has changed since; the manifest itself if its record of the
  /// step was edited.
  std::vector<std::string> changed_since(std::string_view step, const Context& context) const;

  /// Removes unfinished files of a run that was killed.
  void remove_unfinished() const;

  /// Removes the records of a step and of all steps that used its results, then their files: the recorded ones, and
  /// those of `leaves` that exist.
  void forget(const std::string& step, const std::vector<std::string>& leaves);
  /// Size and hash of files, given by their paths below the folder. Throws ErrorCode::input if a file is missing.
  std::vector<Output> examine(const std::vector<std::string>& paths, const Context& context) const;
  /// Records the step as done; `times` holds the time used. The manifest is on the disk when this returns.
  void finish(const std::string& step, Record record, Json times);
  /// Records a value under a name of its own at the top of the manifest.
  void set_info(const std::string& name, const Json& value);
  /// The same for the time that something other than a step used.
  void set_times(const std::string& name, const Json& times);

  /// The manifest of a folder. Throws ErrorCode::input if it has none, or one that is damaged or was edited.
  static Json read_manifest(const std::filesystem::path& folder);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace malus
