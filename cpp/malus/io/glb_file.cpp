#include "malus/io/glb_file.h"

#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <string_view>
#include <vector>

#include "malus/core/version.h"
#include "malus/io/atomic_file.h"
#include "malus/io/image_codecs_internal.h"

namespace malus {
namespace {

using Json = nlohmann::ordered_json;

static_assert(std::endian::native == std::endian::little, "glTF is written in the machine's byte order");

constexpr int jpeg_quality = 92;
// Numbers of the glTF 2.0 specification.
constexpr int type_float = 5126, type_uint = 5125, target_vertices = 34962, target_indices = 34963;
constexpr int wrap_clamp = 33071, filter_linear = 9729, filter_mipmap = 9987;
constexpr std::uint32_t magic = 0x46546C67, format_version = 2, chunk_json = 0x4E4F534A, chunk_binary = 0x004E4942;

/// The binary part of the file and the description of its pieces.
class Buffer {
 public:
  /// Appends `values` as a piece of its own and returns the number of its view.
  template <class T>
  int add(const std::vector<T>& values, std::optional<int> target) {
    return add(std::string_view(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)), target);
  }
  int add(std::string_view bytes, std::optional<int> target) {
    Json view = {{"buffer", 0}, {"byteOffset", bytes_.size()}, {"byteLength", bytes.size()}};
    if (target) view["target"] = *target;
    views_.push_back(view);
    bytes_ += bytes;
    bytes_.resize((bytes_.size() + 3) / 4 * 4);
    return static_cast<int>(views_.size()) - 1;
  }

  const std::string& bytes() const { return bytes_; }
  const Json& views() const { return views_; }

 private:
  std::string bytes_;
  Json views_ = Json::array();
};

Json accessor(int view, int component, const char* type, std::size_t count) {
  return {{"bufferView", view}, {"componentType", component}, {"count", count}, {"type", type}};
}

struct Positions {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();  ///< of the bounding box, in metres
  std::vector<std::array<float, 3>> about_middle;
  std::array<float, 3> low{}, high{};
};

Positions positions_in_metres(const std::vector<Eigen::Vector3d>& points, double metres) {
  Eigen::Vector3d low = points.front(), high = points.front();
  for (const Eigen::Vector3d& x : points) {
    low = low.cwiseMin(x);
    high = high.cwiseMax(x);
  }
  Positions positions;
  positions.middle = 0.5 * metres * (low + high);
  positions.low.fill(std::numeric_limits<float>::infinity());
  positions.high.fill(-std::numeric_limits<float>::infinity());
  positions.about_middle.reserve(points.size());
  for (const Eigen::Vector3d& x : points) {
    const Eigen::Vector3f about = (metres * x - positions.middle).cast<float>();
    positions.about_middle.push_back({about.x(), about.y(), about.z()});
    for (std::size_t c = 0; c < 3; ++c) {
      positions.low[c] = std::min(positions.low[c], about[static_cast<Eigen::Index>(c)]);
      positions.high[c] = std::max(positions.high[c], about[static_cast<Eigen::Index>(c)]);
    }
  }
  return positions;
}

std::vector<std::array<float, 2>> texture_coordinates(const std::vector<Eigen::Vector3d>& points,
                                                      const ProjectedTexture& texture) {
  const Size size = texture.camera.size;
  std::vector<std::array<float, 2>> coordinates;
  coordinates.reserve(points.size());
  for (const Eigen::Vector3d& x : points) {
    const Eigen::Vector2d pixel = texture.camera.project(texture.pose.cam_from_world(x));
    coordinates.push_back(
        {static_cast<float>((pixel.x() + 0.5) / size.width), static_cast<float>((pixel.y() + 0.5) / size.height)});
  }
  return coordinates;
}

/// Unit length is required of normals; a mesh may have zero ones.
std::vector<std::array<float, 3>> unit_normals(const std::vector<Eigen::Vector3f>& normals) {
  std::vector<std::array<float, 3>> unit;
  unit.reserve(normals.size());
  for (const Eigen::Vector3f& n : normals) {
    const Eigen::Vector3f u = n.norm() > 0 ? n.normalized() : Eigen::Vector3f::UnitZ();
    unit.push_back({u.x(), u.y(), u.z()});
  }
  return unit;
}

/// Column-major matrix of the camera node: glTF cameras look along −z with y up.
Json camera_matrix(const Pose& pose, double metres) {
  const Eigen::Matrix3d world_from_gl = pose.rotation.transpose() * Eigen::Vector3d(1, -1, -1).asDiagonal();
  const Eigen::Vector3d centre = metres * pose.centre();
  Json matrix = Json::array();
  for (int column = 0; column < 3; ++column) {
    for (int row = 0; row < 3; ++row) matrix.push_back(world_from_gl(row, column));
    matrix.push_back(0.0);
  }
  for (int row = 0; row < 3; ++row) matrix.push_back(centre[row]);
  matrix.push_back(1.0);
  return matrix;
}

Json document(const TriangleMesh& mesh, const ProjectedTexture& texture, const LengthUnit& unit,
              const std::string& name, Buffer& buffer) {
  const std::size_t count = mesh.vertices.points.size();
  const Positions positions = positions_in_metres(mesh.vertices.points, unit.metres);
  Json accessors = Json::array(), attributes;
  Json position = accessor(buffer.add(positions.about_middle, target_vertices), type_float, "VEC3", count);
  position["min"] = positions.low;
  position["max"] = positions.high;
  accessors.push_back(position);
  attributes["POSITION"] = 0;
  if (!mesh.vertices.normals.empty()) {
    attributes["NORMAL"] = accessors.size();
    const int view = buffer.add(unit_normals(mesh.vertices.normals), target_vertices);
    accessors.push_back(accessor(view, type_float, "VEC3", count));
  }
  attributes["TEXCOORD_0"] = accessors.size();
  const int uv = buffer.add(texture_coordinates(mesh.vertices.points, texture), target_vertices);
  accessors.push_back(accessor(uv, type_float, "VEC2", count));
  const auto indices = accessors.size();
  const int triangles = buffer.add(mesh.triangles, target_indices);
  accessors.push_back(accessor(triangles, type_uint, "SCALAR", 3 * mesh.triangles.size()));
  const int image = buffer.add(codecs::encode_jpeg(texture.image, jpeg_quality), std::nullopt);

  const Pinhole& camera = texture.camera;
  const double distance = unit.metres * (texture.pose.centre() - positions.middle / unit.metres).norm();
  return {
      {"asset", {{"version", "2.0"}, {"generator", std::string("Malus ") + version}}},
      {"scene", 0},
      {"scenes", {{{"name", name}, {"nodes", {0, 1}}}}},
      {"nodes",
       {{{"name", name},
         {"mesh", 0},
         {"translation", {positions.middle.x(), positions.middle.y(), positions.middle.z()}}},
        {{"name", "station"}, {"camera", 0}, {"matrix", camera_matrix(texture.pose, unit.metres)}}}},
      {"cameras",
       {{{"name", "station"},
         {"type", "perspective"},
         {"perspective",
          {{"yfov", 2 * std::atan(0.5 * camera.size.height / camera.fy)},
           {"aspectRatio", camera.size.width * camera.fy / (camera.size.height * camera.fx)},
           {"znear", 0.01 * distance}}}}}},
      {"meshes",
       {{{"name", name},
         {"primitives", {{{"attributes", attributes}, {"indices", indices}, {"material", 0}, {"mode", 4}}}}}}},
      {"materials",
       {{{"name", "photograph"},
         {"doubleSided", true},
         {"pbrMetallicRoughness",
          {{"baseColorTexture", {{"index", 0}}}, {"metallicFactor", 0.0}, {"roughnessFactor", 0.9}}}}}},
      {"textures", {{{"sampler", 0}, {"source", 0}}}},
      {"samplers",
       {{{"magFilter", filter_linear}, {"minFilter", filter_mipmap}, {"wrapS", wrap_clamp}, {"wrapT", wrap_clamp}}}},
      {"images", {{{"name", "photograph"}, {"mimeType", "image/jpeg"}, {"bufferView", image}}}},
      {"accessors", accessors},
      {"bufferViews", buffer.views()},
      {"buffers", {{{"byteLength", buffer.bytes().size()}}}}};
}

}  // namespace

void write_glb(const std::filesystem::path& path, const TriangleMesh& mesh, const ProjectedTexture& texture,
               const LengthUnit& unit, const std::string& name) {
  const std::size_t count = mesh.vertices.points.size();
  if (mesh.triangles.empty()) throw input_error("cannot write " + path.string() + ": the mesh has no triangles");
  if (!mesh.vertices.normals.empty() && mesh.vertices.normals.size() != count) {
    throw input_error("cannot write " + path.string() + ": " + std::to_string(count) + " vertices with " +
                      std::to_string(mesh.vertices.normals.size()) + " normals, expected none or as many");
  }
  Buffer buffer;
  std::string json = document(mesh, texture, unit, name, buffer).dump();
  json.resize((json.size() + 3) / 4 * 4, ' ');
  const std::size_t total = 12 + 8 + json.size() + 8 + buffer.bytes().size();
  if (total > std::numeric_limits<std::uint32_t>::max()) {
    throw resource_error("cannot write " + path.string() +
                         ": it would exceed 4 GB, the most that a GLB file can hold; "
                         "lower surface.glb_triangles");
  }
  AtomicFile file(path);
  const auto put = [&](std::uint32_t value) { file.write(&value, sizeof value); };
  put(magic);
  put(format_version);
  put(static_cast<std::uint32_t>(total));
  put(static_cast<std::uint32_t>(json.size()));
  put(chunk_json);
  file.write(json);
  put(static_cast<std::uint32_t>(buffer.bytes().size()));
  put(chunk_binary);
  file.write(buffer.bytes());
  file.commit();
}

}  // namespace malus
