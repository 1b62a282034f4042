#pragma once

// Private to the station room: a given prior in the station's unit, scaled to metric size by known distances, and its
// stated standard deviation.

#include <concepts>
#include <string>
#include <variant>
#include <vector>

#include "malus/core/context.h"
#include "malus/io/colmap_workspace_internal.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/point_cloud_file_internal.h"
#include "malus/options/prior_options.h"
#include "malus/station/json_fields_internal.h"
#include "malus/station/station.h"

namespace malus {

/// A prior's source with its lengths multiplied by `scale` (StationFile::prior_scale).
PointCloud scaled(PointCloud cloud, double scale);
TriangleMesh scaled(TriangleMesh mesh, double scale);
Shape scaled(Shape shape, double scale);
Image<float> scaled(Image<float> depth, double scale);

/// Calls use(prior) with the station's prior in memory and in the station's unit: a cloud, mesh, depth map, shape or
/// SweptDepth, or std::monostate without one. Files are read for this.
template <class Use>
auto with_prior(const Station& station, const Context& context, const Use& use) {
  const double scale = station.file.prior_scale;
  const auto with_source = [&]<class Source>(const Source& source) {
    if constexpr (std::same_as<Source, CloudFile>) {
      return use(scaled(read_cloud(source.path, context), scale));
    } else if constexpr (std::same_as<Source, MeshFile>) {
      return use(scaled(read_mesh(source.path, context), scale));
    } else if constexpr (std::same_as<Source, DepthFile>) {
      return use(scaled(read_float_raster(source.path, "prior depth map"), scale));
    } else if constexpr (std::same_as<Source, SweptDepth> || std::same_as<Source, std::monostate>) {
      return use(source);  // swept depth maps are in the station's unit already
    } else {
      return use(scaled(source, scale));
    }
  };
  return std::visit(with_source, station.prior);
}

/// The options with the standard deviation that the station file states, unless they state one themselves.
PriorOptions with_stated_sigma(PriorOptions options, const StationFile& station);

/// The scale and the remaining error of each scale bar, in one line; empty without bars that scale a given prior.
std::string describe_scale(const StationFile& station);

/// The same for quality.json: `scale`, and each distance with its residual (scaled minus given); null without such
/// bars.
Json scale_json(const StationFile& station);

/// Warnings of scale bars whose error remains too large after scaling.
std::vector<std::string> scale_warnings(const StationFile& station);

}  // namespace malus
