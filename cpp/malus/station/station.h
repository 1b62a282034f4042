#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "malus/core/finding.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/shape.h"
#include "malus/io/station_spec.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// Source of the coarse surface: none (yet); a file; a shape, a cloud or a mesh in the world frame; a depth map (z in
/// the undistorted view, NaN = none); a depth map measured over windows.
using PriorSource = std::variant<std::monostate, CloudFile, MeshFile, DepthFile, Shape, PointCloud, TriangleMesh,
                                 Image<float>, SweptDepth>;

/// What the photogrammetry that found a station's camera and prior reports.
struct Photogrammetry {
  std::string figures_json;           ///< a JSON object; quality.json repeats its members
  std::string times_json = "{}";      ///< seconds of the photogrammetry's parts, for the manifest
  std::vector<std::string> warnings;  ///< "<step>: <sentence>"
  /// Files that were read besides the photos, such as their masks, and their SHA-256.
  std::map<std::filesystem::path, std::string> files = {};
};

/// One camera position with images taken through a linear polarizer, and what is known about the object: the content of
/// a station file, or the same data given in memory.
struct Station {
  StationFile file;

  // Data given in memory replaces the files that `file` would name.
  std::vector<Image<float>> images;  ///< linear, [0, 1] of the white level, one per polarizer position
  bool whole_numbers = false;        ///< the images hold whole digital numbers; file.polarized states their white level
  std::optional<Mask> mask;          ///< of the images as taken, non-zero = object
  std::optional<Mask> labels;  ///< of the images as taken, with ReflectionChoice::labels: see OpticsSpec::label_image
  PriorSource prior;
  std::optional<Photogrammetry> photogrammetry;
  std::vector<std::filesystem::path>
      developed_from;  ///< RAW files from which the images that file.polarized names were developed
  std::vector<Finding>
      file_findings;  ///< where the image files' own metadata and the station file contradict each other

  bool in_memory() const { return !images.empty(); }
  bool has_prior() const { return !std::holds_alternative<std::monostate>(prior); }

  /// Reads and checks a station file (not the images). photos_of: a file, such as that of an object, whose [photos] are
  /// used if the station file has neither [photos] nor [prior]. Throws ErrorCode::input.
  static Station load(const std::filesystem::path& path,
                      const std::optional<std::filesystem::path>& photos_of = std::nullopt);
};

/// Content of a station as JSON, for people and programs: name, unit, images, angles, camera, prior, patches, profiles.
std::string describe_station_json(const Station& station);

/// Warnings about a station's own control points, known distances and unused pose. Every run gives them again, outside
/// of any step. If they belonged to a step, the step would depend on the points' names and on each distance, and a
/// change of these that does not affect the surface would repeat the step and all that follow it.
std::vector<std::string> station_warnings(const Station& station);

}  // namespace malus
