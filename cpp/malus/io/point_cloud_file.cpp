#include <algorithm>

#include "malus/io/input_file_internal.h"
#include "malus/io/ply_header_internal.h"
#include "malus/io/ply_reader_internal.h"
#include "malus/io/point_cloud_file_internal.h"
#include "malus/io/xyz_reader_internal.h"

namespace malus {
namespace {

/// Throws for files that are neither PLY nor text; nothing of the file may have been read.
void require_text(InputFile& file) {
  const auto is_of_text = [](char c) {
    return static_cast<unsigned char>(c) >= ' ' || c == '\n' || c == '\r' || c == '\t';
  };
  if (!std::ranges::all_of(file.buffered().substr(0, 512), is_of_text))
    throw file.error("is neither PLY nor text with x y z in each line");
}

/// Throws for formats that only the Python package reads.
void require_no_scan(const std::filesystem::path& path, const InputFile& file) {
  const std::string suffix = in_lower_case(path.extension().string());
  if (suffix == ".las" || suffix == ".laz" || suffix == ".e57")
    throw file.error("is LAS or E57, which only the Python package reads (malus run); expected PLY or text");
}

/// The points of any file, and the faces of a PLY if they are wanted.
TriangleMesh read_points(const std::filesystem::path& path, const std::string& what, PlyParts parts,
                         const Context& context) {
  InputFile file(path, what);
  require_no_scan(path, file);
  if (is_ply(file)) return read_ply(file, parts, context);
  require_text(file);
  return {read_xyz(file, context), {}};
}

}  // namespace

PointCloud read_point_cloud(const std::filesystem::path& path, const Context& context, const std::string& what) {
  return read_points(path, what, PlyParts::vertices, context).vertices;
}

TriangleMesh read_mesh(const std::filesystem::path& path, const Context& context) {
  InputFile file(path, "mesh");
  if (!is_ply(file)) throw file.error("is not a PLY file, expected one; convert other meshes, such as OBJ and STL");
  TriangleMesh mesh = read_ply(file, PlyParts::vertices_and_faces, context);
  if (mesh.triangles.empty()) throw file.error("has no faces, expected some; points alone are a cloud");
  return mesh;
}

TriangleMesh read_cloud_or_mesh(const std::filesystem::path& path, const Context& context) {
  return read_points(path, "reference", PlyParts::vertices_and_faces, context);
}

}  // namespace malus
