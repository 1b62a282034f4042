#pragma once

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "malus/core/image.h"
#include "malus/core/length_unit_internal.h"

namespace malus {

/// Position of a raster in its own plane: x to the right and y up, the center of its top-left pixel at (0, 0).
struct PlaneReference {
  double pixel = 1;   ///< size of a pixel in both directions, in `unit`
  LengthUnit unit;    ///< of the plane's coordinates and of the values
  std::string title;  ///< name of the local coordinate system
  /// Further metadata, as name and value (GDAL shows them as the dataset's metadata).
  std::vector<std::pair<std::string, std::string>> metadata;
};

/// GeoTIFF 1.1 of one float channel in a local engineering coordinate system (not on the Earth): ModelPixelScale and
/// ModelTiepoint with pixels as areas, GeoKeys of a user-defined model with its unit, GDAL's nodata value and metadata;
/// NaN = no data. Atomic. Throws as write_float_tiff, and an input error unless the raster has one channel.
void write_geotiff(const std::filesystem::path& path, const Image<float>& image, const PlaneReference& reference);

}  // namespace malus
