#pragma once

// Private to the station room: the parts of a station that enter the steps' keys, with a hash of every file or array.

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "malus/core/context.h"
#include "malus/station/json_fields_internal.h"
#include "malus/station/station.h"

namespace malus {

/// Values and hashes that a station's results depend on. Every file is read once.
class StationInputs {
 public:
  StationInputs(const Station& station, const std::optional<std::filesystem::path>& reference, const Context& context)
      : station_(station), reference_(reference), context_(context) {}

  /// A part of the station; see below.
  using Part = Json (StationInputs::*)();

  /// Parts of the station, and the files and arrays they were read from.
  struct Values {
    Json parts = Json::array();
    std::map<std::string, std::string> hashes;  ///< path relative to the station file, or name of an array → SHA-256
    std::vector<std::filesystem::path> files;   ///< the files among those
  };
  Values of(const std::vector<Part>& parts);
  /// Throws an input error if one of the files has changed since it was hashed.
  void require_unchanged(const Values& values) const;

  Json title();
  /// [object].
  Json object();
  Json polarized();
  /// [optics] except `metal`, on which only the fusion depends.
  Json optics();
  Json metal();
  /// The lens alone: undistortion depends on nothing else of the camera.
  Json lens();
  /// Lens and pose.
  Json camera();
  Json prior();
  /// [[patch]], [[profile]], [[control]] and the [[scale]] of a given prior, whose figures are in quality.json.
  /// Warnings about them are not part of a step: every run gives them again.
  Json regions();
  /// The reference scan, and the photogrammetry's figures.
  Json comparison();

 private:
  Json file(const std::filesystem::path& path) { return files({path})[0]; }
  Json files(const std::vector<std::filesystem::path>& paths);
  template <class T>
  Json array(const std::string& name, const T& values);
  /// Names and hashes of the photos that a swept surface comes from, as the photogrammetry states them; null without.
  Json photos();
  std::string name_of(const std::filesystem::path& path) const;

  const Station& station_;
  const std::optional<std::filesystem::path>& reference_;
  const Context& context_;
  std::map<std::filesystem::path, std::string> known_;
  Values* taken_ = nullptr;
};

}  // namespace malus
