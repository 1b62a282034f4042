#pragma once

// Private to the station room: what of a station goes into the steps' keys, with a hash of every file or array.

#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <string>

#include "malus/core/context.h"
#include "malus/station/station.h"

namespace malus {

using Json = nlohmann::ordered_json;

/// Values and hashes a station's results depend on. Every file is read once.
class StationInputs {
 public:
  StationInputs(const Station& station, const Context& context) : station_(station), context_(context) {}

  Json polarized();
  Json optics();
  /// The lens alone, which is all that undistortion depends on.
  Json lens();
  /// Lens and pose.
  Json camera();
  Json prior();
  /// [[patch]] and [[profile]].
  Json regions();
  /// Hash of any other file, e.g. a reference scan.
  Json file(const std::filesystem::path& path);

  /// Path, as the station file gives it, and SHA-256 of every file hashed so far.
  const std::map<std::string, std::string>& hashes() const { return hashes_; }

 private:
  template <class T>
  Json array(const T* data, std::size_t count);

  const Station& station_;
  const Context& context_;
  std::map<std::string, std::string> hashes_;
};

}  // namespace malus
