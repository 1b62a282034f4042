#pragma once

#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/io/input_file_internal.h"

namespace malus {

/// What is read of a PLY.
enum class PlyParts { vertices, vertices_and_faces };

/// Reads the vertices of a PLY, and its faces, split into triangle fans, if there are any and they are wanted; nothing
/// of the file may have been read. Errors are those of read_point_cloud and read_mesh, but a PLY without faces is none.
TriangleMesh read_ply(InputFile& file, PlyParts parts, const Context& context);

}  // namespace malus
