#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/io/station_file.h"
#include "malus/prior/project_prior.h"

namespace malus {

/// One camera position with images taken through a linear polarizer, and what is known about the object around it:
/// what a station file says, or the same given in memory.
struct Station {
  StationFile file;

  // Data given in memory replaces the files that `file` would name.
  std::vector<Image<float>> images;  ///< linear, [0, 1] of the white level, one a polarizer position
  std::optional<Mask> mask;
  std::optional<PointCloud> cloud;          ///< world frame
  std::optional<Image<float>> prior_depth;  ///< z in the undistorted view, NaN = none
  std::optional<SweptDepth> swept;          ///< depth in the undistorted view, measured over windows
  /// What the photogrammetry says of itself that made camera and prior: JSON of an object, repeated in quality.json.
  std::optional<std::string> photogrammetry_json;

  bool in_memory() const { return !images.empty(); }
  bool has_prior() const { return cloud || prior_depth || swept || file.prior; }

  /// Reads and checks a station file (not the images). Throws ErrorCode::input.
  static Station load(const std::filesystem::path& path) {
    Station station;
    station.file = read_station_file(path);
    return station;
  }
};

}  // namespace malus
