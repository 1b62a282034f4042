#pragma once

#include <array>
#include <filesystem>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/field_list.h"
#include "malus/core/fields.h"
#include "malus/core/pose.h"
#include "malus/core/reflection_choice.h"
#include "malus/core/shape.h"

namespace malus {

// Everything that a station file can state. Each spec lists its fields once, with ranges as options do (core/fields.h)
// or by name only (core/field_list.h). That list feeds the reader of station files, the description for people and for
// Python, and the record of what results depend on.

/// Numbers greater than zero.
inline constexpr Range positive_range{std::numeric_limits<double>::min()};

/// Stands in place of a range in a spec's list of fields: the station file writes this field in a form of its own, for
/// which its section has a reader.
struct OwnForm {};
inline constexpr OwnForm own_form{};

/// In which direction a polarizer's scale counts, as the image is displayed.
enum class AngleDirection { counter_clockwise, clockwise };
constexpr auto names_of(AngleDirection) {
  return std::to_array<std::string_view>({"ccw", "cw"});
}

/// Which channel, or combination of channels, of a color image is used.
enum class ColorChannel { luminance, red, green, blue, mean };
constexpr auto names_of(ColorChannel) {
  return std::to_array<std::string_view>({"luminance", "red", "green", "blue", "mean"});
}

/// How the numbers of an image file depend on the light; by default linearly.
class Response {
 public:
  enum class Kind { linear, srgb, gamma, table };

  Response() = default;
  /// "linear", "srgb", "gamma:X", or else the path of a lookup table. Nothing if X is no number from 0.1 to 10.
  static std::optional<Response> of(const std::string& text);

  Kind kind() const { return kind_; }
  /// gamma: linear = encoded ^ exponent.
  double exponent() const { return exponent_; }
  /// As stated; of a lookup table the path, which is absolute once loaded.
  const std::string& text() const { return text_; }
  /// Whether the numbers are linear already.
  bool is_identity() const { return kind_ == Kind::linear || (kind_ == Kind::gamma && exponent_ == 1); }
  /// The file of a lookup table; nothing for another kind, even if a file of its name lies in the current folder.
  std::optional<std::filesystem::path> table() const {
    return kind_ == Kind::table ? std::optional<std::filesystem::path>(text_) : std::nullopt;
  }

 private:
  Response(Kind kind, double exponent, std::string text) : kind_(kind), exponent_(exponent), text_(std::move(text)) {}

  Kind kind_ = Kind::linear;
  double exponent_ = 1;
  std::string text_ = "linear";
};

/// Color filters over the 2 × 2 cells of a color camera's mosaic, by rows.
enum class BayerPattern { rggb, bggr, grbg, gbrg };
constexpr auto names_of(BayerPattern) {
  return std::to_array<std::string_view>({"RGGB", "BGGR", "GRBG", "GBRG"});
}

/// [polarized]: the images taken through the polarizer, and how to read them. Paths are absolute once loaded.
struct PolarizedSpec {
  std::vector<std::filesystem::path> images;      ///< one per polarizer position, or one mosaic (see `mosaic`)
  std::optional<std::vector<double>> angles_deg;  ///< as read off the filter scale; nothing = "auto"
  AngleDirection angle_direction = AngleDirection::counter_clockwise;
  double angle_zero_deg = 0;  ///< what the scale reads when the axis is along image +x
  std::optional<std::array<double, 4>>
      mosaic;  ///< angles of the 2 × 2 cell: top left, top right, bottom left, bottom right
  std::optional<BayerPattern> mosaic_colors;  ///< of a color camera's mosaic
  /// Exposure times [s] of the images if they differ on purpose; images of one angle are merged. Nothing = all equal.
  std::optional<std::vector<double>> exposure_s;
  ColorChannel channel = ColorChannel::luminance;
  std::optional<std::array<double, 3>> channel_weights;  ///< weighted sum of R, G, B instead of `channel`
  Response response{};
  std::optional<double> white_level;  ///< DN; nothing = from the file's bit depth
  double black_level = 0;             ///< DN
  int frames_averaged = 1;
  std::optional<double> full_well_e;  ///< electrons at white level
  std::optional<double> read_noise_e;
  std::optional<std::filesystem::path> mask;
  std::vector<std::array<double, 2>> curve_pixels;  ///< shown as intensity against angle; empty = chosen automatically

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("images", self.images, own_form);
    visit("angles_deg", self.angles_deg, own_form);
    visit("angle_direction", self.angle_direction, any_value);
    visit("angle_zero_deg", self.angle_zero_deg, Range{-360, 360});
    visit("mosaic", self.mosaic, own_form);
    visit("mosaic_colors", self.mosaic_colors, own_form);
    visit("exposure_s", self.exposure_s, own_form);
    visit("channel", self.channel, any_value);
    visit("channel_weights", self.channel_weights, own_form);
    visit("response", self.response, own_form);
    visit("white_level", self.white_level, positive_range);
    visit("black_level", self.black_level, not_negative);
    visit("frames_averaged", self.frames_averaged, Range{1, 1e6});
    visit("full_well_e", self.full_well_e, positive_range);
    visit("read_noise_e", self.read_noise_e, not_negative);
    visit("mask", self.mask, any_value);
    visit("curve_pixels", self.curve_pixels, own_form);
  }
};

/// [object]: catalog entries about the object and who recorded it. Text for reports and archives, never used in
/// computations.
struct ObjectSpec {
  std::optional<std::string> identifier, title, maker, date, place, material, description, collection;
  std::optional<std::string> recorded_by, recorded_on;
  std::optional<std::string> rights, license;

  MALUS_FIELDS(identifier, title, maker, date, place, material, description, collection, recorded_by, recorded_on,
               rights, license)
};

/// [optics]
struct OpticsSpec {
  std::optional<double> refractive_index = 1.5;  ///< nothing = "auto"
  ReflectionChoice reflection = ReflectionChoice::automatic;
  std::optional<std::filesystem::path> label_image;  ///< with `labels`: 1 = diffuse, 2 = specular, 0 = decide
  std::optional<std::array<double, 3>> light;        ///< direction to the source, camera frame; nothing = estimated
  std::string metal = "auto";  ///< what bare metal the object is: see docs/station-file.md; a list [n, k] as "n+ki"

  MALUS_FIELDS(refractive_index, reflection, label_image, light, metal)
};

/// [camera], resolved: from a COLMAP model or given in the file.
struct CameraSpec {
  LensCamera lens;
  Pose pose;
};

/// [prior]: exactly one of a cloud, a mesh, a depth map and a shape.
struct CloudFile {
  std::filesystem::path path;  ///< a file, or the folder of a COLMAP workspace
};
struct MeshFile {
  std::filesystem::path path;
};
struct DepthFile {
  std::filesystem::path path;
};
using PriorFile = std::variant<CloudFile, MeshFile, DepthFile, Shape>;

/// [photos]
struct PhotosSpec {
  std::filesystem::path folder;
  std::vector<std::string> exclude;
  std::optional<std::filesystem::path> masks;  ///< folder of the photos' masks
  std::optional<LensCamera> camera;

  MALUS_FIELDS(folder, exclude, masks, camera)
};

/// A mark of one point in one photo, memory pixel convention.
struct ImageMark {
  std::string image;
  double x = 0, y = 0;

  MALUS_FIELDS(image, x, y)
};

/// Families of square coded targets, in OpenCV's order.
enum class TargetDictionary {
  aruco_4x4_50,
  aruco_4x4_100,
  aruco_4x4_250,
  aruco_4x4_1000,
  aruco_5x5_50,
  aruco_5x5_100,
  aruco_5x5_250,
  aruco_5x5_1000,
  aruco_6x6_50,
  aruco_6x6_100,
  aruco_6x6_250,
  aruco_6x6_1000,
  aruco_7x7_50,
  aruco_7x7_100,
  aruco_7x7_250,
  aruco_7x7_1000,
  aruco_original,
  apriltag_16h5,
  apriltag_25h9,
  apriltag_36h10,
  apriltag_36h11
};
constexpr auto names_of(TargetDictionary) {
  return std::to_array<std::string_view>(
      {"aruco_4x4_50",  "aruco_4x4_100",  "aruco_4x4_250", "aruco_4x4_1000", "aruco_5x5_50",   "aruco_5x5_100",
       "aruco_5x5_250", "aruco_5x5_1000", "aruco_6x6_50",  "aruco_6x6_100",  "aruco_6x6_250",  "aruco_6x6_1000",
       "aruco_7x7_50",  "aruco_7x7_100",  "aruco_7x7_250", "aruco_7x7_1000", "aruco_original", "apriltag_16h5",
       "apriltag_25h9", "apriltag_36h10", "apriltag_36h11"});
}

/// [[scale]]: a known distance between two marked points, two coded targets, or two points of a given prior's frame.
struct ScaleBar {
  double distance = 0;
  std::vector<ImageMark> a, b;
  std::optional<std::array<int, 2>> targets;
  std::optional<TargetDictionary> targets_dictionary;  ///< set with `targets`
  std::optional<std::array<double, 3>> a_xyz, b_xyz;   ///< without [photos]; both or none
  bool check = false;

  MALUS_FIELDS(distance, a, b, targets, targets_dictionary, a_xyz, b_xyz, check)
};

/// A point of known coordinates and its position in an image.
struct MarkedPoint {
  std::string name;
  Eigen::Vector3d xyz = Eigen::Vector3d::Zero();
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();  ///< as taken (distorted), memory pixel convention
};

/// [[control]]: a point of known coordinates, marked in photos, in the polarized image, or in both.
struct ControlPoint {
  std::string name;
  std::array<double, 3> xyz{};  ///< in the frame wanted for the result, station unit
  std::optional<std::array<double, 2>>
      pixel;                     ///< in the polarized image as taken: column and row, memory pixel convention
  std::vector<ImageMark> marks;  ///< in photos
  bool check = false;            ///< held out of the fit: its residual shows how good the fit is

  /// The point and its `pixel`, which must be set.
  MarkedPoint marked() const { return {name, {xyz[0], xyz[1], xyz[2]}, {(*pixel)[0], (*pixel)[1]}}; }

  MALUS_FIELDS(name, xyz, pixel, marks, check)
};

/// Pose of a camera from points of known coordinates.
struct Resection {
  Pose pose;
  double rms_px = 0;        ///< of the distances between marks and projected points
  double center_sigma = 0;  ///< standard deviation of the projection center along its most uncertain direction
  std::optional<std::string>
      doubtful;  ///< point without which all other points fit far better: its mark is likely wrong
};

/// [[patch]]: flat reference area in the polarized image.
struct PatchSpec {
  std::string name;
  std::array<int, 4> box{};  ///< x0, y0, x1, y1: corners, inclusive

  MALUS_FIELDS(name, box)
};

/// [[profile]]: a section line, pixels of the polarized image.
struct ProfileSpec {
  std::string name;
  std::array<double, 2> from{}, to{};

  MALUS_FIELDS(name, from, to)
};

/// Everything that a station file states.
struct StationFile {
  std::filesystem::path path;  ///< of the file itself; empty for a station made in code
  std::string name;
  std::string unit = "mm";
  ObjectSpec object;
  PolarizedSpec polarized;
  OpticsSpec optics;
  std::optional<CameraSpec>
      camera;  ///< known lens and pose; with a depth map or shape as prior and no pose, the world frame is the camera's
  std::optional<LensCamera> lens;  ///< known lens; the pose comes from [photos]; never set together with `camera`
  bool has_unused_pose = false;    ///< [camera] has a pose, but the station is placed among the [photos]
  std::vector<std::filesystem::path> camera_files;  ///< of the COLMAP model that `camera` was read from
  std::optional<std::string> camera_image;          ///< [camera].image: the station's name in the photos' model
  std::optional<PriorFile> prior;
  std::optional<double> prior_sigma;  ///< stated standard deviation of the prior, station unit
  std::optional<PhotosSpec> photos;
  std::vector<ScaleBar> scale_bars;
  double prior_scale = 1;  ///< of a given prior, from the scale bars; already applied to the camera's position
  std::vector<double> scale_errors;  ///< of each bar after scaling, station unit
  std::vector<ControlPoint> control;
  std::optional<Resection> resection;  ///< set if the control points gave the camera's pose
  std::vector<PatchSpec> patches;
  std::vector<ProfileSpec> profiles;

  /// Its place in messages.
  std::string where() const { return path.empty() ? "station " + name : path.string(); }
  /// Whether the surface is computed from [photos]; the result is then in the photos' frame.
  bool frame_is_of_photos() const { return photos && !prior; }
  /// The lens, whether the pose is known or not.
  std::optional<LensCamera> known_lens() const { return camera ? std::optional(camera->lens) : lens; }
};

}  // namespace malus
