#include <array>
#include <bit>
#include <cmath>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "malus/core/version.h"
#include "malus/io/atomic_file_internal.h"
#include "malus/io/glb_file_internal.h"
#include "malus/io/image_codecs_internal.h"
#include "malus/io/record_writer_internal.h"

namespace malus {
namespace {

using GltfJson = nlohmann::ordered_json;

static_assert(std::endian::native == std::endian::little, "glTF is written in the machine's byte order");

constexpr int jpeg_quality = 92;
// Numbers of the glTF 2.0 specification.
constexpr int type_float = 5126, type_uint = 5125, target_vertices = 34962, target_indices = 34963;
constexpr int wrap_clamp = 33071, filter_linear = 9729, filter_mipmap = 9987;
constexpr std::uint32_t glb_magic = 0x46546C67, format_version = 2, chunk_json = 0x4E4F534A, chunk_binary = 0x004E4942;

/// The binary part of the file and the description of its sections. Sections are made only when they are written,
/// because together they are larger than the mesh.
class Buffer {
 public:
  using Write = std::function<void(AtomicFile&, std::size_t offset, const Context&)>;

  /// Appends a section of `size` bytes that write(file, offset, context) writes, and returns the index of its buffer
  /// view.
  int add(std::size_t size, std::optional<int> target, Write write) {
    GltfJson view = {{"buffer", 0}, {"byteOffset", size_}, {"byteLength", size}};
    if (target) view["target"] = *target;
    views_.push_back(view);
    pieces_.push_back({size, std::move(write)});
    size_ += aligned(size);
    return static_cast<int>(views_.size()) - 1;
  }
  /// Appends one record for each of `items`, which must outlive the buffer.
  template <class Item, class Convert>
  int add_records(const std::vector<Item>& items, int target, Convert convert) {
    constexpr std::size_t record = sizeof(decltype(convert(items.front())));
    return add(items.size() * record, target,
               [&items, convert](AtomicFile& file, std::size_t offset, const Context& context) {
                 write_records(file, offset, items.size(), record, context,
                               [&](std::size_t i, FileBlock& block) { block.put(convert(items[i])); });
               });
  }

  std::size_t size() const { return size_; }
  const GltfJson& views() const { return views_; }
  void write(AtomicFile& file, std::size_t offset, const Context& context) const {
    for (const Piece& piece : pieces_) {
      piece.write(file, offset, context);
      const std::string padding(aligned(piece.size) - piece.size, '\0');
      file.write_at(offset + piece.size, padding.data(), padding.size());
      offset += aligned(piece.size);
    }
  }

 private:
  struct Piece {
    std::size_t size;
    Write write;
  };
  static std::size_t aligned(std::size_t size) { return (size + 3) / 4 * 4; }

  std::size_t size_ = 0;
  std::vector<Piece> pieces_;
  GltfJson views_ = GltfJson::array();
};

GltfJson accessor(int view, int component, const char* type, std::size_t count) {
  return {{"bufferView", view}, {"componentType", component}, {"count", count}, {"type", type}};
}

using Float2 = std::array<float, 2>;
using Float3 = std::array<float, 3>;

/// Positions in meters about the middle of their bounding box.
class Positions {
 public:
  Positions(const std::vector<Eigen::Vector3d>& points, double meters) : meters_(meters) {
    Eigen::AlignedBox3d box;
    for (const Eigen::Vector3d& x : points) box.extend(x);
    middle = 0.5 * meters * (box.min() + box.max());
    low = (*this)(box.min());
    high = (*this)(box.max());
  }
  Float3 operator()(const Eigen::Vector3d& x) const {
    const Eigen::Vector3f about = (meters_ * x - middle).cast<float>();
    return {about.x(), about.y(), about.z()};
  }

  Eigen::Vector3d middle;  ///< in meters
  Float3 low, high;

 private:
  double meters_;
};

Float2 texture_coordinate(const Eigen::Vector3d& x, const ProjectedTexture& texture) {
  // The last texels may reach beyond the view, so that the texture's sides are those of its texels, not of the camera.
  const int width = texture.texel_px * texture.image.width(), height = texture.texel_px * texture.image.height();
  const Eigen::Vector2d pixel = texture.camera.project(texture.pose.cam_from_world(x));
  return {static_cast<float>((pixel.x() + 0.5) / width), static_cast<float>((pixel.y() + 0.5) / height)};
}

/// glTF requires normals of unit length; a mesh may have zero normals.
Float3 unit_normal(const Eigen::Vector3f& normal) {
  const float norm = normal.norm();
  const Eigen::Vector3f unit = norm > 0 ? Eigen::Vector3f(normal / norm) : Eigen::Vector3f::UnitZ();
  return {unit.x(), unit.y(), unit.z()};
}

/// Column-major matrix of the camera node: glTF cameras look along −z with y up.
GltfJson camera_matrix(const Pose& pose, double meters) {
  Eigen::Matrix4d world_from_gl = Eigen::Matrix4d::Identity();
  world_from_gl.topLeftCorner<3, 3>() = pose.rotation.transpose() * Eigen::Vector3d(1, -1, -1).asDiagonal();
  world_from_gl.topRightCorner<3, 1>() = meters * pose.center();
  return std::vector<double>(world_from_gl.data(), world_from_gl.data() + world_from_gl.size());
}

GltfJson document(const TriangleMesh& mesh, const ProjectedTexture& texture, const LengthUnit& unit,
                  const std::string& name, Buffer& buffer) {
  const std::size_t count = mesh.vertices.points.size();
  const Positions positions(mesh.vertices.points, unit.meters);
  GltfJson accessors = GltfJson::array(), attributes;
  GltfJson position =
      accessor(buffer.add_records(mesh.vertices.points, target_vertices, positions), type_float, "VEC3", count);
  position["min"] = positions.low;
  position["max"] = positions.high;
  accessors.push_back(position);
  attributes["POSITION"] = 0;
  if (!mesh.vertices.normals.empty()) {
    attributes["NORMAL"] = accessors.size();
    const int view = buffer.add_records(mesh.vertices.normals, target_vertices, unit_normal);
    accessors.push_back(accessor(view, type_float, "VEC3", count));
  }
  attributes["TEXCOORD_0"] = accessors.size();
  const int uv = buffer.add_records(mesh.vertices.points, target_vertices,
                                    [&texture](const Eigen::Vector3d& x) { return texture_coordinate(x, texture); });
  accessors.push_back(accessor(uv, type_float, "VEC2", count));
  const auto indices = accessors.size();
  const int triangles =
      buffer.add_records(mesh.triangles, target_indices, [](const auto& triangle) { return triangle; });
  accessors.push_back(accessor(triangles, type_uint, "SCALAR", 3 * mesh.triangles.size()));
  std::string jpeg = codecs::encode_jpeg(texture.image, jpeg_quality);
  const std::size_t jpeg_bytes = jpeg.size();
  const int image = buffer.add(jpeg_bytes, std::nullopt,
                               [jpeg = std::move(jpeg)](AtomicFile& file, std::size_t offset, const Context&) {
                                 file.write_at(offset, jpeg.data(), jpeg.size());
                               });

  const Pinhole& camera = texture.camera;
  const double distance = unit.meters * (texture.pose.center() - positions.middle / unit.meters).norm();
  return {
      {"asset", {{"version", "2.0"}, {"generator", std::string("Malus ") + version}}},
      {"scene", 0},
      {"scenes", {{{"name", name}, {"nodes", {0, 1}}}}},
      {"nodes",
       {{{"name", name},
         {"mesh", 0},
         {"translation", {positions.middle.x(), positions.middle.y(), positions.middle.z()}}},
        {{"name", "station"}, {"camera", 0}, {"matrix", camera_matrix(texture.pose, unit.meters)}}}},
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
      {"buffers", {{{"byteLength", buffer.size()}}}}};
}

}  // namespace

void write_glb(const std::filesystem::path& path, const TriangleMesh& mesh, const ProjectedTexture& texture,
               const LengthUnit& unit, const std::string& name, const Context& context, const std::string& extras) {
  const std::size_t count = mesh.vertices.points.size();
  if (mesh.triangles.empty()) throw input_error("cannot write " + path.string() + ": the mesh has no triangles");
  if (!mesh.vertices.normals.empty() && mesh.vertices.normals.size() != count) {
    throw input_error("cannot write " + path.string() + ": " + std::to_string(count) + " vertices with " +
                      std::to_string(mesh.vertices.normals.size()) + " normals, expected none or as many");
  }
  Buffer buffer;
  GltfJson content = document(mesh, texture, unit, name, buffer);
  if (!extras.empty()) content["asset"]["extras"] = GltfJson::parse(extras);
  std::string json = content.dump();
  json.resize((json.size() + 3) / 4 * 4, ' ');
  const std::size_t first_piece = 12 + 8 + json.size() + 8, total = first_piece + buffer.size();
  if (total > std::numeric_limits<std::uint32_t>::max()) {
    throw resource_error("cannot write " + path.string() +
                         ": it would exceed 4 GB, the most that a GLB file can hold; "
                         "lower surface.glb_triangles (malus export: --faces)");
  }
  AtomicFile file(path);
  file.expect(total);
  const auto put = [&](std::uint32_t value) { file.write(&value, sizeof value); };
  put(glb_magic);
  put(format_version);
  put(static_cast<std::uint32_t>(total));
  put(static_cast<std::uint32_t>(json.size()));
  put(chunk_json);
  file.write(json);
  put(static_cast<std::uint32_t>(buffer.size()));
  put(chunk_binary);
  buffer.write(file, first_piece, context);
  file.commit();
}

}  // namespace malus
