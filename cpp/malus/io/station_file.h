#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"

namespace malus {

/// [polarized]: the images taken through the polarizer, and how to read them. Paths are absolute once loaded.
struct PolarizedSpec {
  std::vector<std::filesystem::path> images;      ///< one a polarizer position, or one mosaic (see `mosaic`)
  std::optional<std::vector<double>> angles_deg;  ///< as read off the filter scale; nothing = "auto"
  std::string angle_direction = "ccw";            ///< "ccw" | "cw", as displayed
  double angle_zero_deg = 0;                      ///< what the scale reads when the axis is along image +x
  std::optional<std::array<double, 4>>
      mosaic;  ///< angles of the 2 × 2 cell: top left, top right, bottom left, bottom right
  std::optional<std::string> mosaic_colors;  ///< of a colour camera's mosaic: Bayer pattern of the cells, "RGGB"
  /// Exposure times [s] of the images, deliberately different: images of one angle are merged. Nothing = all alike.
  std::optional<std::vector<double>> exposure_s;
  std::string channel = "luminance";                     ///< "luminance" | "red" | "green" | "blue" | "mean"
  std::optional<std::array<double, 3>> channel_weights;  ///< weighted sum of R, G, B instead of `channel`
  std::string response = "linear";                       ///< "linear" | "srgb" | "gamma:2.2" | path of a lookup table
  std::optional<double> white_level;                     ///< DN; nothing = from the file's bit depth
  double black_level = 0;                                ///< DN
  int frames_averaged = 1;
  std::optional<double> full_well_e;  ///< electrons at white level
  std::optional<double> read_noise_e;
  std::optional<std::filesystem::path> mask;
};

/// [optics]
struct OpticsSpec {
  std::optional<double> refractive_index = 1.5;      ///< nothing = "auto"
  std::string reflection = "auto";                   ///< "diffuse" | "specular" | "auto" | "labels"
  std::optional<std::filesystem::path> label_image;  ///< with "labels": 1 = diffuse, 2 = specular, 0 = decide
};

/// [camera], resolved: from a COLMAP model or given in the file.
struct CameraSpec {
  LensCamera lens;
  Pose pose;
};

/// [prior]: exactly one of the three.
struct PriorSpec {
  std::optional<std::filesystem::path> cloud, mesh, depth;
};

/// [photos]
struct PhotosSpec {
  std::filesystem::path folder;
  std::vector<std::string> exclude;
  std::optional<LensCamera> camera;
};

/// A mark of one point in one photo, memory pixel convention.
struct ImageMark {
  std::string image;
  double x = 0, y = 0;
};

/// [[scale]]: a known distance between two marked points or two coded targets.
struct ScaleBar {
  double distance = 0;
  std::vector<ImageMark> a, b;
  std::optional<std::array<int, 2>> targets;
  std::string targets_dictionary;
  bool check = false;
};

/// [[patch]]: flat reference area, corners inclusive, in the polarized image.
struct PatchSpec {
  std::string name;
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
};

/// [[profile]]: a section line, pixels of the polarized image.
struct ProfileSpec {
  std::string name;
  std::array<double, 2> from{}, to{};
};

/// Everything a station file says.
struct StationFile {
  std::filesystem::path path;  ///< of the file itself
  std::string name;
  std::string unit = "mm";
  PolarizedSpec polarized;
  OpticsSpec optics;
  std::optional<CameraSpec>
      camera;                      ///< known lens and pose; with a depth-map prior and no pose, the world is the camera
  std::optional<LensCamera> lens;  ///< known lens, pose to come from [photos]; never together with `camera`
  std::optional<std::string> camera_image;  ///< [camera].image: the station's name in the photos' model
  std::optional<PriorSpec> prior;
  std::optional<PhotosSpec> photos;
  std::vector<ScaleBar> scale_bars;
  std::vector<PatchSpec> patches;
  std::vector<ProfileSpec> profiles;
};

/// Reads and checks a station file (docs/station-file.md describes every key): syntax, keys (an unknown key is an error
/// that names the nearest known one), types, ranges, that every named file exists and is readable; resolves folders,
/// globs, angle patterns and COLMAP models. Of images only the first polarized one's size is read, against which
/// camera, patches and profiles are checked; clouds are not read. Throws ErrorCode::input with file, line, field, value
/// and what was expected; ErrorCode::data for fewer than three images or fewer than three distinct polarizer angles
/// modulo 180°.
StationFile read_station_file(const std::filesystem::path& path);

}  // namespace malus
