#include <Eigen/Geometry>

#include "malus/core/degrees_internal.h"
#include "malus/io/colmap_model_internal.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/resection_internal.h"
#include "malus/io/section_reading_internal.h"
#include "malus/io/station_sections_internal.h"

namespace malus {
namespace {

/// Keys of a lens: model BROWN's parameters by name, and the keys that all models have.
const Keys brown_keys{"focal_mm", "pixel_mm", "x0_mm", "y0_mm", "k1", "k2", "k3", "p1", "p2", "p3"};
const Keys lens_keys{"model", "width", "height", "params"};
/// Keys of a pose.
const Keys pose_keys{"qvec", "tvec", "omega_phi_kappa_deg", "center"};

/// Lens in COLMAP's order and pixel convention (params), or photogrammetric (BROWN, millimeters).
LensCamera read_lens(const TomlTable& table) {
  constexpr Range side{1, 65536};
  LensCamera lens;
  lens.model =
      lens_model(table.required(table.text("model"), "model", "the name of a camera model"), table.where("model"));
  lens.size.width = table.required(table.integer("width", side), "width", "the image width in pixels");
  lens.size.height = table.required(table.integer("height", side), "height", "the image height in pixels");
  if (lens.model == LensModel::brown) {
    refuse(table, {"params"}, "is not used by model BROWN, expected focal_mm, pixel_mm, x0_mm, …");
    lens.params.push_back(table.required(table.number("focal_mm", positive_range), "focal_mm", "the camera constant"));
    lens.params.push_back(table.required(table.number("pixel_mm", positive_range), "pixel_mm", "the pixel's size"));
    for (std::size_t i = 2; i < brown_keys.size(); ++i) lens.params.push_back(table.number(brown_keys[i]).value_or(0));
  } else {
    refuse(table, brown_keys, "belongs to model BROWN, not to " + std::string(to_string(lens.model)));
    lens.params = table.required(table.numbers("params"), "params", "the parameters in COLMAP's order");
  }
  lens.validate(table.where("params"));
  return from_colmap_pixels(std::move(lens));
}

/// Photogrammetric rotation M = R3(κ) R2(φ) R1(ω), world to image (x right, y up, z towards the viewer).
Eigen::Matrix3d rotation_from_omega_phi_kappa(const std::array<double, 3>& angles_deg) {
  const auto axis_rotation = [](double angle_deg, const Eigen::Vector3d& axis) {
    return Eigen::AngleAxisd(to_radians(-angle_deg), axis).toRotationMatrix();
  };
  return axis_rotation(angles_deg[2], Eigen::Vector3d::UnitZ()) *
         axis_rotation(angles_deg[1], Eigen::Vector3d::UnitY()) *
         axis_rotation(angles_deg[0], Eigen::Vector3d::UnitX());
}

/// Pose as qvec and tvec (COLMAP), or as omega_phi_kappa_deg and center (Eq 12: M = diag(1, −1, −1) R, X0 = −Rᵀ t).
std::optional<Pose> read_pose(const TomlTable& table) {
  const bool colmap = table.has("qvec") || table.has("tvec");
  const bool photogrammetric = table.has("omega_phi_kappa_deg") || table.has("center");
  if (colmap && photogrammetric)
    throw table.error("qvec", "cannot be given together with omega_phi_kappa_deg and center");
  Pose pose;
  if (colmap) {
    const auto q = table.required(table.numbers_exactly<4>("qvec"), "qvec", "a quaternion (w, x, y, z)");
    const auto t = table.required(table.numbers_exactly<3>("tvec"), "tvec", "the translation (x, y, z)");
    pose.rotation = rotation_from_quaternion(q, table.where("qvec"));
    pose.translation = {t[0], t[1], t[2]};
    return pose;
  }
  if (photogrammetric) {
    const auto angles = table.required(table.numbers_exactly<3>("omega_phi_kappa_deg", {-360, 360}),
                                       "omega_phi_kappa_deg", "three angles in degrees");
    const auto center =
        table.required(table.numbers_exactly<3>("center"), "center", "the projection center (X0, Y0, Z0)");
    pose.rotation = Eigen::Vector3d(1, -1, -1).asDiagonal() * rotation_from_omega_phi_kappa(angles);
    pose.translation = -pose.rotation * Eigen::Vector3d(center[0], center[1], center[2]);
    return pose;
  }
  return std::nullopt;
}

void read_colmap_camera(const TomlTable& table, StationFile& station) {
  refuse(table, joined({lens_keys, brown_keys, pose_keys}), "cannot be given together with colmap_model");
  const auto folder = table.resolve("colmap_model", *table.text("colmap_model"));
  const std::string name = table.required(table.text("image"), "image", "the station's image name in the COLMAP model");
  if (!std::filesystem::is_directory(folder))
    throw table.wrong("colmap_model", "a folder with cameras and images files");
  const ColmapModel model = read_colmap_model(folder, ColmapParts::cameras_and_images);
  const ColmapImage& image = model.image(name, table.where("image"));
  station.camera = CameraSpec{model.cameras.at(image.camera_id), image.pose};
  station.camera_files = colmap_model_files(folder);
}

/// `images`: size of the polarized images, as far as it is known.
void require_camera_size(const TomlTable& document, const LensCamera& lens, const std::optional<Size>& images,
                         const StationFile& station) {
  if (!images || lens.size == *images) return;
  const bool turned = lens.size.width == images->height && lens.size.height == images->width;
  throw input_error(document.where("[camera]") + " is for " + to_string(lens.size) +
                    " pixels, but the polarized image " + station.polarized.images.front().string() + " has " +
                    to_string(*images) +
                    (turned ? "; EXIF orientation is ignored: turn the pixels of the images and of the mask" : ""));
}

/// Sets the camera's pose from the control points.
void resect_camera(const TomlTable& document, const LensCamera& lens, StationFile& station) {
  require_control_in_image(document, station, lens.size);
  std::vector<MarkedPoint> points;
  for (const ControlPoint& point : station.control)
    if (!point.check) points.push_back(point.marked());
  station.resection = resect(points, lens, station.path.string() + ": [[control]]");
  station.camera = CameraSpec{lens, station.resection->pose};
}

/// The camera of [camera]; `images` as in require_camera_size.
void read_camera_table(const TomlTable& document, const TomlTable& table, const std::optional<Size>& images,
                       StationFile& station) {
  station.camera_image = table.text("image");
  if (table.has("colmap_model")) {
    read_colmap_camera(table, station);
    require_camera_size(document, station.camera->lens, images, station);
    return;
  }
  if (!table.has("model")) {
    if (station.frame_is_of_photos() && station.camera_image) return;
    throw table.error("model", "is missing, expected colmap_model and image, or model, width, height and params");
  }
  const LensCamera lens = read_lens(table);
  require_camera_size(document, lens, images, station);
  const std::optional<Pose> pose = read_pose(table);
  if (pose) {
    station.camera = CameraSpec{lens, *pose};
  } else if (!station.control.empty() && !station.frame_is_of_photos()) {
    resect_camera(document, lens, station);
  } else if (station.frame_is_of_photos()) {
    station.lens = lens;
  } else if (station.prior &&
             (std::holds_alternative<DepthFile>(*station.prior) || std::holds_alternative<Shape>(*station.prior))) {
    station.camera = CameraSpec{lens, Pose{}};
  } else {
    throw table.error(
        "qvec",
        "is missing, expected qvec and tvec, or omega_phi_kappa_deg and center; only with [[control]] points, "
        "[photos] and no [prior], or with a depth-map prior or a plane, sphere or cylinder can the pose be left out");
  }
}

}  // namespace

std::optional<LensCamera> lens_in(const TomlTable& section) {
  const auto camera = section.section("camera", joined({lens_keys, brown_keys}));
  return camera ? std::optional(read_lens(*camera)) : std::nullopt;
}

std::optional<Size> size_of_images(const StationFile& station, const std::string& where) {
  if (station.polarized.images.empty()) return std::nullopt;
  const std::filesystem::path& first = station.polarized.images.front();
  return is_raw_name(first) ? std::nullopt : std::optional(read_image_size(first, where));
}

Size size_of_camera(const StationFile& station) {
  constexpr Size anything{65536, 65536};
  return station.known_lens() ? station.known_lens()->size : anything;
}

void read_camera(const TomlTable& document, const std::optional<Size>& images, StationFile& station) {
  const Keys camera_keys = joined({{"colmap_model", "image"}, lens_keys, pose_keys, brown_keys});
  const auto table = document.section("camera", camera_keys);
  if (!table) return;
  read_camera_table(document, *table, images, station);
  station.has_unused_pose = station.frame_is_of_photos() && station.camera;
}

}  // namespace malus
