#pragma once

#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/io/input_file_internal.h"

namespace malus {

/// Reads a text with the coordinates of a point in each line; nothing of the file may have been read. Columns and
/// errors are those of read_point_cloud.
PointCloud read_xyz(InputFile& file, const Context& context);

}  // namespace malus
