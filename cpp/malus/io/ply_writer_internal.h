#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/geometry.h"

namespace malus {

/// Writes binary little-endian PLY, atomically (see AtomicFile): x, y, z, then normals (float) and colors (uchar) where
/// there are any; faces (list uchar int vertex_indices); comments in the header, one per line. Coordinates are float
/// unless rounding to float could move a point by more than a thousandth of the mean vertex spacing (diagonal of the
/// bounding box / √count), as in a national grid; in that case they are double.
void write_ply(const std::filesystem::path& path, const TriangleMesh& mesh, const Context& context = {},
               const std::vector<std::string>& comments = {});
/// The same file from strips.
void write_ply(const std::filesystem::path& path, const MeshInStrips& mesh, const Context& context = {},
               const std::vector<std::string>& comments = {});

}  // namespace malus
