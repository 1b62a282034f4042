#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string_view>

#include "malus/core/digits_internal.h"
#include "malus/io/atomic_file_internal.h"
#include "malus/io/colmap_model_internal.h"
#include "malus/io/input_file_internal.h"

namespace malus {
namespace {

/// COLMAP's numbers of its camera models and of their parameters. Images of the models without a counterpart here are
/// left out.
struct ModelId {
  std::int32_t id;
  std::string_view name;
  int parameters;
  bool supported = true;
};
constexpr ModelId model_ids[] = {{0, "SIMPLE_PINHOLE", 3},
                                 {1, "PINHOLE", 4},
                                 {2, "SIMPLE_RADIAL", 4},
                                 {3, "RADIAL", 5},
                                 {4, "OPENCV", 8},
                                 {5, "OPENCV_FISHEYE", 8, false},
                                 {6, "FULL_OPENCV", 12},
                                 {7, "FOV", 5, false},
                                 {8, "SIMPLE_RADIAL_FISHEYE", 4, false},
                                 {9, "RADIAL_FISHEYE", 5, false},
                                 {10, "THIN_PRISM_FISHEYE", 12, false},
                                 {11, "RAD_TAN_THIN_PRISM_FISHEYE", 16, false},
                                 {12, "SIMPLE_DIVISION", 4, false},
                                 {13, "DIVISION", 5, false},
                                 {14, "SIMPLE_FISHEYE", 3, false},
                                 {15, "FISHEYE", 4, false},
                                 {16, "EUCM", 6, false},
                                 {17, "EQUIRECTANGULAR", 2, false}};

/// COLMAP's model with this name or number, or null.
template <class Key>
const ModelId* known_model(Key ModelId::*key, const Key& value) {
  const auto* const found = std::ranges::find(model_ids, value, key);
  return found == std::end(model_ids) ? nullptr : found;
}

std::int32_t id_of_model(LensModel model) {
  if (const ModelId* const known = known_model(&ModelId::name, to_string(model))) return known->id;
  throw input_error("camera model " + std::string(to_string(model)) + " cannot be written as a COLMAP model");
}

LensCamera shifted(LensCamera camera, double offset) {
  if (camera.model == LensModel::brown) return camera;
  const auto cx = static_cast<std::size_t>(principal_point_index(camera.model));
  if (camera.params.size() > cx + 1) {
    camera.params[cx] += offset;
    camera.params[cx + 1] += offset;
  }
  return camera;
}

constexpr double colmap_offset = 0.5;

/// The model being read, with the checks that both formats share.
class Builder {
 public:
  explicit Builder(std::filesystem::path folder) : folder_(std::move(folder)) {}

  void add_camera(std::uint32_t id, LensCamera camera, std::uint64_t width, std::uint64_t height,
                  const std::string& where) {
    constexpr std::uint64_t longest_side = 65536;
    camera.size = {static_cast<int>(std::min(width, longest_side + 1)),
                   static_cast<int>(std::min(height, longest_side + 1))};
    camera.validate(where);
    if (!model_.cameras.emplace(id, from_colmap_pixels(std::move(camera))).second) {
      throw input_error(where + ": camera id " + std::to_string(id) + " appears twice");
    }
  }

  /// A camera whose images are left out.
  void add_unsupported_camera(std::uint32_t id, std::string_view model) { unsupported_.emplace(id, model); }

  void add_image(std::uint32_t id, ColmapImage image, const std::string& where) {
    if (const auto found = unsupported_.find(image.camera_id); found != unsupported_.end()) {
      model_.left_out.emplace(std::move(image.name), found->second);
      return;
    }
    if (!model_.cameras.contains(image.camera_id)) {
      throw input_error(where + ": image \"" + image.name + "\" has camera id " + std::to_string(image.camera_id) +
                        ", which the cameras file does not have");
    }
    if (!image.pose.translation.allFinite()) throw input_error(where + ": the translation is not finite");
    if (!model_.images.emplace(id, std::move(image)).second) {
      throw input_error(where + ": image id " + std::to_string(id) + " appears twice");
    }
  }

  void add_point(std::uint64_t id, ColmapPoint point, const std::string& where) {
    if (!point.position.allFinite()) throw input_error(where + ": the position is not finite");
    model_.points.emplace(id, std::move(point));
  }

  ColmapModel take() { return std::move(model_); }
  std::filesystem::path file(const char* name) const { return folder_ / name; }

 private:
  std::filesystem::path folder_;
  ColmapModel model_;
  std::map<std::uint32_t, std::string> unsupported_;
};

// ---- text ----

/// Words of one line; every value that is missing or malformed is an error with file and line.
class Words {
 public:
  Words(std::string_view line, std::string where) : rest_(line), where_(std::move(where)) {}

  std::string_view next() {
    skip_blanks();
    const std::string_view word = rest_.substr(0, rest_.find_first_of(" \t"));
    rest_.remove_prefix(word.size());
    return word;
  }
  template <class T>
  T number(const char* name) {
    const std::string_view word = next();
    if (const auto value = number_of<T>(word)) return *value;
    throw input_error(where_ + ": " + name + " = \"" + std::string(word) + "\", expected a number");
  }
  bool done() {
    skip_blanks();
    return rest_.empty();
  }
  /// The rest of the line, without surrounding blanks.
  std::string_view rest() {
    skip_blanks();
    return rest_.substr(0, rest_.find_last_not_of(" \t") + 1);
  }

 private:
  void skip_blanks() { rest_.remove_prefix(std::min(rest_.find_first_not_of(" \t"), rest_.size())); }

  std::string_view rest_;
  std::string where_;
};

std::string where_of(const std::filesystem::path& path, const InputFile& file) {
  return path.string() + " line " + std::to_string(file.line_number());
}

/// Calls `read` for every line that is no comment with its words, its place for messages, and the file, of which it may
/// read further lines.
template <class Read>
void for_each_line(const std::filesystem::path& path, const char* what, Read&& read) {
  InputFile file(path, what);
  for (std::string_view line; file.read_line(line);) {
    if (is_comment(line, {"#"})) continue;
    const std::string where = where_of(path, file);
    read(Words(line, where), where, file);
  }
}

void read_cameras_text(Builder& builder) {
  for_each_line(builder.file("cameras.txt"), "COLMAP cameras", [&](Words words, const std::string& where, InputFile&) {
    const auto id = words.number<std::uint32_t>("camera id");
    const std::string_view name = words.next();
    if (const ModelId* const known = known_model(&ModelId::name, name); known != nullptr && !known->supported) {
      builder.add_unsupported_camera(id, name);
      return;
    }
    LensCamera camera;
    camera.model = lens_model(name, where + ": camera model");
    const auto width = words.number<std::uint64_t>("width"), height = words.number<std::uint64_t>("height");
    while (!words.done()) camera.params.push_back(words.number<double>("parameter"));
    builder.add_camera(id, std::move(camera), width, height, where);
  });
}

std::vector<ColmapKeypoint> read_keypoints_text(std::string_view line, const std::string& where) {
  std::vector<ColmapKeypoint> keypoints;
  for (Words words(line, where); !words.done();) {
    const auto x = words.number<double>("x"), y = words.number<double>("y");
    const auto point = words.number<std::int64_t>("point id");
    keypoints.push_back({Eigen::Vector2d(x - colmap_offset, y - colmap_offset), static_cast<std::uint64_t>(point)});
  }
  return keypoints;
}

void read_images_text(Builder& builder, ColmapParts parts) {
  const auto path = builder.file("images.txt");
  for_each_line(path, "COLMAP images", [&](Words words, const std::string& where, InputFile& file) {
    const auto id = words.number<std::uint32_t>("image id");
    ColmapImage image;
    std::array<double, 4> quaternion{};
    for (double& q : quaternion) q = words.number<double>("quaternion");
    image.pose.rotation = rotation_from_quaternion(quaternion, where + ": quaternion");
    for (double& t : image.pose.translation) t = words.number<double>("translation");
    image.camera_id = words.number<std::uint32_t>("camera id");
    image.name = words.rest();
    // The line after an image lists its keypoints and is empty where there are none.
    std::string_view line;
    if (file.read_line(line) && parts == ColmapParts::everything) {
      image.keypoints = read_keypoints_text(line, where_of(path, file));
    }
    builder.add_image(id, std::move(image), where);
  });
}

void read_points_text(Builder& builder) {
  for_each_line(builder.file("points3D.txt"), "COLMAP points", [&](Words words, const std::string& where, InputFile&) {
    const auto id = words.number<std::uint64_t>("point id");
    ColmapPoint point;
    for (double& x : point.position) x = words.number<double>("position");
    for (auto& channel : point.color) channel = words.number<std::uint8_t>("color");
    point.error_px = words.number<double>("error");
    while (!words.done()) {
      const auto image = words.number<std::uint32_t>("image id"), keypoint = words.number<std::uint32_t>("keypoint");
      point.track.emplace_back(image, keypoint);
    }
    builder.add_point(id, std::move(point), where);
  });
}

// ---- binary, little-endian ----

template <class T>
T read_value(InputFile& file) {
  T value;
  file.read(&value, sizeof value);
  return value;
}

/// A count, refused when the rest of the file is too short for that many records.
std::uint64_t read_count(InputFile& file, std::uint64_t smallest_record, const char* what) {
  const auto count = read_value<std::uint64_t>(file);
  if (count > file.remaining() / smallest_record) {
    throw file.error("claims " + std::to_string(count) + " " + what + ", more than its " + std::to_string(file.size()) +
                     " bytes can hold");
  }
  return count;
}

void read_cameras_binary(Builder& builder) {
  const auto path = builder.file("cameras.bin");
  InputFile file(path, "COLMAP cameras");
  const std::uint64_t count = read_count(file, 24, "cameras");
  for (std::uint64_t i = 0; i < count; ++i) {
    const auto id = read_value<std::uint32_t>(file);
    const std::string where = path.string() + " camera " + std::to_string(id);
    const int number = read_value<std::int32_t>(file);
    const auto width = read_value<std::uint64_t>(file), height = read_value<std::uint64_t>(file);
    const ModelId* const known = known_model(&ModelId::id, number);
    if (known != nullptr && !known->supported) {
      file.skip(static_cast<std::uint64_t>(known->parameters) * sizeof(double));
      builder.add_unsupported_camera(id, known->name);
      continue;
    }
    LensCamera camera;
    camera.model = lens_model(known != nullptr ? known->name : std::to_string(number), where + ": camera model");
    camera.params.resize(static_cast<std::size_t>(parameter_count(camera.model)));
    for (double& parameter : camera.params) parameter = read_value<double>(file);
    builder.add_camera(id, std::move(camera), width, height, where);
  }
}

std::string read_name(InputFile& file) {
  constexpr std::size_t longest_name = 4096;
  std::string name;
  for (char c; (c = read_value<char>(file)) != '\0';) {
    if (name.size() == longest_name) throw file.error("has an image name of more than 4096 bytes");
    name.push_back(c);
  }
  return name;
}

void read_images_binary(Builder& builder, ColmapParts parts) {
  const auto path = builder.file("images.bin");
  InputFile file(path, "COLMAP images");
  const std::uint64_t count = read_count(file, 73, "images");
  for (std::uint64_t i = 0; i < count; ++i) {
    const auto id = read_value<std::uint32_t>(file);
    const std::string where = path.string() + " image " + std::to_string(id);
    ColmapImage image;
    const auto quaternion = read_value<std::array<double, 4>>(file);
    image.pose.rotation = rotation_from_quaternion(quaternion, where + ": quaternion");
    for (double& t : image.pose.translation) t = read_value<double>(file);
    image.camera_id = read_value<std::uint32_t>(file);
    image.name = read_name(file);
    const std::uint64_t keypoints = read_count(file, 24, "keypoints");
    if (parts == ColmapParts::everything) image.keypoints.reserve(keypoints);
    for (std::uint64_t k = 0; k < keypoints; ++k) {
      const auto pixel = read_value<std::array<double, 2>>(file);
      const auto point = read_value<std::uint64_t>(file);
      if (parts != ColmapParts::everything) continue;
      image.keypoints.push_back({Eigen::Vector2d(pixel[0] - colmap_offset, pixel[1] - colmap_offset), point});
    }
    builder.add_image(id, std::move(image), where);
  }
}

void read_points_binary(Builder& builder) {
  const auto path = builder.file("points3D.bin");
  InputFile file(path, "COLMAP points");
  const std::uint64_t count = read_count(file, 51, "points");
  for (std::uint64_t i = 0; i < count; ++i) {
    const auto id = read_value<std::uint64_t>(file);
    ColmapPoint point;
    for (double& x : point.position) x = read_value<double>(file);
    point.color = read_value<Rgb>(file);
    point.error_px = read_value<double>(file);
    point.track.resize(read_count(file, 8, "observations"));
    for (auto& [image, keypoint] : point.track) {
      image = read_value<std::uint32_t>(file);
      keypoint = read_value<std::uint32_t>(file);
    }
    builder.add_point(id, std::move(point), path.string() + " point " + std::to_string(id));
  }
}

// ---- writing ----

template <class T>
void append(std::string& bytes, const T& value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

constexpr std::string_view cameras_header = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n";
constexpr std::string_view images_header =
    "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n";

std::string camera_record(std::uint32_t id, const LensCamera& camera) {
  std::string record;
  append(record, id);
  append(record, id_of_model(camera.model));
  append(record, static_cast<std::uint64_t>(camera.size.width));
  append(record, static_cast<std::uint64_t>(camera.size.height));
  for (const double parameter : shifted(camera, colmap_offset).params) append(record, parameter);
  return record;
}

std::string image_record(std::uint32_t id, const ColmapImage& image) {
  std::string record;
  append(record, id);
  append(record, quaternion_from_rotation(image.pose.rotation));
  for (const double t : image.pose.translation) append(record, t);
  append(record, image.camera_id);
  record.append(image.name.c_str(), image.name.size() + 1);
  append(record, static_cast<std::uint64_t>(image.keypoints.size()));
  for (const ColmapKeypoint& keypoint : image.keypoints) {
    append(record, keypoint.pixel.x() + colmap_offset);
    append(record, keypoint.pixel.y() + colmap_offset);
    append(record, keypoint.point_id);
  }
  return record;
}

std::string point_record(std::uint64_t id, const ColmapPoint& point) {
  std::string record;
  append(record, id);
  for (const double x : point.position) append(record, x);
  append(record, point.color);
  append(record, point.error_px);
  append(record, static_cast<std::uint64_t>(point.track.size()));
  for (const auto& [image, keypoint] : point.track) {
    append(record, image);
    append(record, keypoint);
  }
  return record;
}

template <class Map, class Encode>
void write_records(const std::filesystem::path& path, const Map& records, Encode&& encode) {
  std::string count;
  append(count, static_cast<std::uint64_t>(records.size()));
  AtomicFile file(path);
  file.write(count);
  for (const auto& [id, record] : records) file.write(encode(id, record));
  file.commit();
}

}  // namespace

void ColmapModel::transform(double scale, const Eigen::Matrix3d& rotation, const Eigen::Vector3d& translation) {
  for (auto& [id, registered] : images) {
    Pose& pose = registered.pose;
    pose.rotation = (pose.rotation * rotation.transpose()).eval();
    pose.translation = scale * pose.translation - pose.rotation * translation;
  }
  for (auto& [id, point] : points) point.position = (scale * (rotation * point.position) + translation).eval();
}

const ColmapImage& ColmapModel::image(const std::string& name, const std::string& where) const {
  constexpr int names_shown = 8;
  std::string names;
  int shown = 0;
  for (const auto& [id, candidate] : images) {
    if (candidate.name == name) return candidate;
    if (++shown <= names_shown) names += (shown == 1 ? "" : ", ") + candidate.name;
  }
  if (const auto found = left_out.find(name); found != left_out.end()) {
    throw input_error(where + " = \"" + name + "\" is of a camera with the model " + found->second +
                      ", which is not supported; expected an image that COLMAP's image_undistorter made");
  }
  if (shown > names_shown) names += ", …";
  throw input_error(where + " = \"" + name + "\" is not in the COLMAP model; it has " +
                    (names.empty() ? "no images" : names));
}

Eigen::Matrix3d rotation_from_quaternion(const std::array<double, 4>& wxyz, const std::string& where) {
  const Eigen::Quaterniond quaternion(wxyz[0], wxyz[1], wxyz[2], wxyz[3]);
  const double length = quaternion.norm();
  if (!std::isfinite(length) || length < 1e-9) {
    throw input_error(where + " has no direction; expected a rotation as (w, x, y, z)");
  }
  return quaternion.normalized().toRotationMatrix();
}

std::array<double, 4> quaternion_from_rotation(const Eigen::Matrix3d& rotation) {
  Eigen::Quaterniond quaternion(rotation);
  quaternion.normalize();
  const double sign = quaternion.w() < 0 ? -1 : 1;
  return {sign * quaternion.w(), sign * quaternion.x(), sign * quaternion.y(), sign * quaternion.z()};
}

LensCamera from_colmap_pixels(LensCamera camera) {
  return shifted(std::move(camera), -colmap_offset);
}

std::vector<std::filesystem::path> colmap_model_files(const std::filesystem::path& folder) {
  for (const std::string ending : {".bin", ".txt"}) {
    const std::vector files{folder / ("cameras" + ending), folder / ("images" + ending)};
    if (std::filesystem::exists(files[0]) && std::filesystem::exists(files[1])) return files;
  }
  throw input_error(
      "COLMAP model " + folder.string() +
      (std::filesystem::is_directory(folder) ? " has no cameras and images files (.bin or .txt)" : " is not a folder"));
}

ColmapModel read_colmap_model(const std::filesystem::path& folder, ColmapParts parts) {
  Builder builder(folder);
  const bool points = parts == ColmapParts::everything;
  if (colmap_model_files(folder)[0].extension() == ".bin") {
    read_cameras_binary(builder);
    read_images_binary(builder, parts);
    if (points && std::filesystem::exists(builder.file("points3D.bin"))) read_points_binary(builder);
  } else {
    read_cameras_text(builder);
    read_images_text(builder, parts);
    if (points && std::filesystem::exists(builder.file("points3D.txt"))) read_points_text(builder);
  }
  return builder.take();
}

void write_colmap_model(const std::filesystem::path& folder, const ColmapModel& model) {
  write_records(folder / "cameras.bin", model.cameras, camera_record);
  write_records(folder / "images.bin", model.images, image_record);
  write_records(folder / "points3D.bin", model.points, point_record);
}

std::string colmap_text(const Pinhole& camera) {
  std::string text(cameras_header);
  text += "1 PINHOLE " + std::to_string(camera.size.width) + " " + std::to_string(camera.size.height);
  for (const double parameter : {camera.fx, camera.fy, camera.cx + colmap_offset, camera.cy + colmap_offset})
    text += " " + shortest_text(parameter);
  return text + "\n";
}

std::string colmap_text(const Pose& pose, const std::string& image_name) {
  std::string text = std::string(images_header) + "1";
  for (const double q : quaternion_from_rotation(pose.rotation)) text += " " + shortest_text(q);
  for (const double t : pose.translation) text += " " + shortest_text(t);
  return text + " 1 " + image_name + "\n\n";
}

Image<float> read_colmap_array(const std::filesystem::path& path) {
  InputFile file(path, "COLMAP depth or normal map");
  std::array<std::uint64_t, 3> shape{};
  for (std::uint64_t& side : shape) {
    char digit = 0;
    int digits = 0;
    for (file.read(&digit, 1); digit != '&'; file.read(&digit, 1)) {
      if (digit < '0' || digit > '9' || ++digits > 9) throw file.error("has no header width&height&channels&");
      side = side * 10 + static_cast<std::uint64_t>(digit - '0');
    }
  }
  const auto [width, height, channels] = shape;
  if (width < 1 || height < 1 || width > 65536 || height > 65536 || (channels != 1 && channels != 3)) {
    throw file.error("claims " + std::to_string(width) + " x " + std::to_string(height) + " pixels with " +
                     std::to_string(channels) + " channels, expected 1 or 3 channels");
  }
  const std::uint64_t area = width * height;
  if (file.remaining() != area * channels * sizeof(float)) {
    throw file.error("has " + std::to_string(file.remaining()) + " bytes of pixels, expected " +
                     std::to_string(area * channels * sizeof(float)));
  }
  Image<float> image({static_cast<int>(width), static_cast<int>(height)}, static_cast<int>(channels));
  std::vector<float> row(width);
  for (int c = 0; c < image.channels(); ++c) {
    for (int v = 0; v < image.height(); ++v) {
      file.read(row.data(), row.size() * sizeof(float));
      for (int u = 0; u < image.width(); ++u) image(u, v, c) = row[static_cast<std::size_t>(u)];
    }
  }
  for (std::size_t i = 0; i < area; ++i) {
    float* pixel = image.data() + i * channels;
    if (std::all_of(pixel, pixel + channels, [](float value) { return value == 0; })) {
      std::fill(pixel, pixel + channels, no_value);
    }
  }
  return image;
}

}  // namespace malus
