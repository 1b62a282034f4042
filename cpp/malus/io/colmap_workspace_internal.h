#pragma once

#include <cstddef>
#include <filesystem>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/geometry.h"

namespace malus {

/// Points, with normals, of a workspace of COLMAP's dense stereo (`image_undistorter`, then `patch_match_stereo`): the
/// depth maps `stereo/depth_maps/<image>.geometric.bin` of the cameras in `sparse/`, world frame of that model. Normals
/// are taken from `stereo/normal_maps` where these exist. Maps may be smaller than their camera's image. If there are
/// more than `largest_count` pixels, only every second, third, … pixel of every second, third, … row is taken.
///
/// Throws ErrorCode::input naming the folder or file: no model, no geometric depth maps (with photometric ones only it
/// says what to run), a map whose image is not in the model, whose shape does not fit its camera, or that is damaged.
PointCloud read_colmap_workspace(const std::filesystem::path& folder, const Context& context = {},
                                 std::size_t largest_count = 20'000'000);

/// A point cloud from a file (read_point_cloud) or a folder (read_colmap_workspace).
PointCloud read_cloud(const std::filesystem::path& path, const Context& context = {});

/// The files of a workspace that read_colmap_workspace reads, sorted. Errors for missing files as there.
std::vector<std::filesystem::path> colmap_workspace_files(const std::filesystem::path& folder);

}  // namespace malus
