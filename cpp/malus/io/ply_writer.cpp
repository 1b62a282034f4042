#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>

#include "malus/core/error.h"
#include "malus/core/parallel_internal.h"
#include "malus/io/atomic_file_internal.h"
#include "malus/io/ply_writer_internal.h"
#include "malus/io/record_writer_internal.h"

namespace malus {
namespace {

static_assert(std::endian::native == std::endian::little, "PLY is written in the machine's byte order");

using Triangle = std::array<std::uint32_t, 3>;

/// Layout of a file's vertices and faces.
struct PlyLayout {
  bool doubles = false, normals = false, colors = false;
  const std::vector<std::string>& comments;

  std::size_t vertex_size() const {
    return 3 * (doubles ? sizeof(double) : sizeof(float)) + (normals ? sizeof(Eigen::Vector3f) : 0) +
           (colors ? sizeof(Rgb) : 0);
  }
  void put_vertex(const PointCloud& cloud, std::size_t i, FileBlock& block) const {
    for (const double x : cloud.points[i]) doubles ? block.put(x) : block.put(static_cast<float>(x));
    if (normals) block.put(cloud.normals[i]);
    if (colors) block.put(cloud.colors[i]);
  }
  static constexpr std::size_t face_size = 1 + sizeof(Triangle);
  static void put_face(const Triangle& triangle, FileBlock& block) {
    block.put(std::uint8_t{3});
    block.put(triangle);
  }
  std::string header(std::size_t vertices, std::size_t faces) const {
    const std::string coordinate = doubles ? "property double " : "property float ";
    std::string header = "ply\nformat binary_little_endian 1.0\n";
    for (const std::string& comment : comments) header += "comment " + comment + "\n";
    header += "element vertex " + std::to_string(vertices) + "\n";
    for (const char* name : {"x", "y", "z"}) header += coordinate + name + "\n";
    if (normals) header += "property float nx\nproperty float ny\nproperty float nz\n";
    if (colors) header += "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    header += "element face " + std::to_string(faces) + "\nproperty list uchar int vertex_indices\n";
    return header + "end_header\n";
  }
};

/// Whether rounding to float could move a vertex by more than a thousandth of the mean spacing.
bool needs_double(const Eigen::AlignedBox3d& box, std::size_t count) {
  if (count == 0) return false;
  constexpr double float_rounding = 1.0 / (1 << 24);
  const double largest = std::max(box.min().cwiseAbs().maxCoeff(), box.max().cwiseAbs().maxCoeff());
  const double spacing = box.diagonal().norm() / std::sqrt(static_cast<double>(count));
  return largest * float_rounding > 1e-3 * spacing;
}

}  // namespace

void write_ply(const std::filesystem::path& path, const TriangleMesh& mesh, const Context& context,
               const std::vector<std::string>& comments) {
  const PointCloud& cloud = mesh.vertices;
  const std::size_t count = cloud.points.size();
  if ((!cloud.normals.empty() && cloud.normals.size() != count) ||
      (!cloud.colors.empty() && cloud.colors.size() != count)) {
    throw input_error("cannot write " + path.string() + ": " + std::to_string(count) + " points with " +
                      std::to_string(cloud.normals.size()) + " normals and " + std::to_string(cloud.colors.size()) +
                      " colors, expected none or as many");
  }
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& point : cloud.points) box.extend(point);
  const PlyLayout layout{needs_double(box, count), !cloud.normals.empty(), !cloud.colors.empty(), comments};
  AtomicFile file(path);
  const std::string header = layout.header(count, mesh.triangles.size());
  file.write(header);
  const std::size_t first_face = header.size() + count * layout.vertex_size();
  file.expect(first_face + mesh.triangles.size() * PlyLayout::face_size);
  write_records(file, header.size(), count, layout.vertex_size(), context,
                [&](std::size_t i, FileBlock& block) { layout.put_vertex(cloud, i, block); });
  write_records(file, first_face, mesh.triangles.size(), PlyLayout::face_size, context,
                [&](std::size_t i, FileBlock& block) { PlyLayout::put_face(mesh.triangles[i], block); });
  file.commit();
}

void write_ply(const std::filesystem::path& path, const MeshInStrips& mesh, const Context& context,
               const std::vector<std::string>& comments) {
  const PlyLayout layout{needs_double(mesh.box, mesh.vertices), true, mesh.has_colors, comments};
  AtomicFile file(path);
  const std::string header = layout.header(mesh.vertices, mesh.triangles);
  file.write(header);
  const std::size_t first_face = header.size() + mesh.vertices * layout.vertex_size();
  file.expect(first_face + mesh.triangles * PlyLayout::face_size);
  parallel_for(context, mesh.strips, 1, [&](std::size_t k, std::size_t) {
    MeshStrip strip = mesh.strip(k, MeshInStrips::Parts::all);
    FileBlock vertices(header.size() + strip.first_vertex * layout.vertex_size(),
                       strip.vertices * layout.vertex_size());
    for (std::size_t i = 0; i < strip.vertices; ++i) layout.put_vertex(strip.mesh.vertices, i, vertices);
    vertices.write_to(file);

    FileBlock faces(first_face + strip.first_triangle * PlyLayout::face_size,
                    strip.mesh.triangles.size() * PlyLayout::face_size);
    const auto first = static_cast<std::uint32_t>(strip.first_vertex);
    for (const auto& [a, b, c] : strip.mesh.triangles) PlyLayout::put_face({a + first, b + first, c + first}, faces);
    faces.write_to(file);
  });
  file.commit();
}

}  // namespace malus
