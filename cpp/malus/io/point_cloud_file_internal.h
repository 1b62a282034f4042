#pragma once

#include <filesystem>
#include <string>

#include "malus/core/context.h"
#include "malus/core/geometry.h"

namespace malus {

/// Reads a point cloud; coordinates are those of the file.
///
/// PLY, ASCII or binary of either byte order, properties in any order and of any type: x, y, z; optionally nx, ny, nz
/// and red, green, blue (floating-point colors are taken as 0 to 1, 16-bit ones are scaled); other properties are
/// ignored. XYZ text: one point per line, separated by blanks, commas or semicolons; lines starting with #, // or % are
/// comments, except that a line with column names (x y z nx ny nz r g b, in any order, and others, which are ignored;
/// in a comment one of these comes first) before the first point defines the columns. Decimal commas are an error.
/// Without names the first three columns are x y z. Of six columns, the last three are normals if some of their numbers
/// are negative or most of these triples have length 1, else r g b. Nine columns have both: of the last two triples the
/// one that looks more like normals is taken for them, if in doubt the last one. With any other number of columns only
/// the first three are used. A normal that is not finite becomes zero.
///
/// Throws ErrorCode::input naming the file: not a point cloud, truncated, more points claimed than its bytes can hold
/// (checked before memory is taken), no x, y or z, malformed line; for coordinates that are not finite the error states
/// their number and the first of them. `what` names the file's purpose in messages.
PointCloud read_point_cloud(const std::filesystem::path& path, const Context& context = {},
                            const std::string& what = "point cloud");

/// Reads a PLY mesh; vertices as in read_point_cloud, polygons are split into triangle fans. Further errors: a file
/// without faces, and vertex indices out of range.
TriangleMesh read_mesh(const std::filesystem::path& path, const Context& context = {});

/// Reads the files of read_mesh, and those of read_point_cloud as a mesh without triangles: a reference.
TriangleMesh read_cloud_or_mesh(const std::filesystem::path& path, const Context& context = {});

}  // namespace malus
