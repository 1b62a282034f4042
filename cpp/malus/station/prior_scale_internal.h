#pragma once

// Private to the station room: scales a given prior to metric size by known distances.

#include <string>
#include <vector>

#include "malus/core/image.h"
#include "malus/core/shape.h"
#include "malus/io/point_cloud_file_internal.h"
#include "malus/io/station_spec.h"

namespace malus {

/// A prior's source with its lengths multiplied by `scale` (StationFile::prior_scale).
PointCloud scaled(PointCloud cloud, double scale);
TriangleMesh scaled(TriangleMesh mesh, double scale);
Shape scaled(Shape shape, double scale);
Image<float> scaled(Image<float> depth, double scale);

/// The scale and the remaining error of each scale bar, in one line; empty without bars that scale a given prior.
std::string describe_scale(const StationFile& station);

/// Warnings of scale bars whose error remains too large after scaling.
std::vector<std::string> scale_warnings(const StationFile& station);

}  // namespace malus
