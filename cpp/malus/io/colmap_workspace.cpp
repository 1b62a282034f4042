#include <algorithm>
#include <cmath>
#include <map>
#include <string>

#include "malus/core/error.h"
#include "malus/io/colmap_model_internal.h"
#include "malus/io/colmap_workspace_internal.h"
#include "malus/io/input_file_internal.h"
#include "malus/io/point_cloud_file_internal.h"

namespace malus {
namespace {

namespace fs = std::filesystem;

constexpr const char* map_suffix = ".geometric.bin";

/// Depth maps by the name of their image.
std::map<std::string, fs::path> depth_maps(const fs::path& folder) {
  const fs::path maps = folder / "stereo" / "depth_maps";
  std::map<std::string, fs::path> found;
  bool photometric = false;
  std::error_code none;
  for (const auto& entry : fs::recursive_directory_iterator(maps, none)) {
    const std::string name = entry.path().lexically_relative(maps).generic_string();
    photometric = photometric || name.ends_with(".photometric.bin");
    if (name.ends_with(map_suffix)) found[name.substr(0, name.size() - std::string(map_suffix).size())] = entry.path();
  }
  if (found.empty()) {
    throw input_error(folder.string() + " has no depth maps stereo/depth_maps/*" + map_suffix +
                      (photometric ? ", only photometric ones; run patch_match_stereo with geom_consistency"
                                   : ", expected a file, or a workspace of COLMAP's dense stereo"));
  }
  return found;
}

fs::path normal_map_of(const fs::path& folder, const std::string& image) {
  return folder / "stereo" / "normal_maps" / (image + map_suffix);
}

/// The camera of a map that may be smaller than its image.
Pinhole camera_of_map(const LensCamera& camera, const Image<float>& map, const fs::path& path) {
  const double su = static_cast<double>(map.width()) / camera.size.width;
  const double sv = static_cast<double>(map.height()) / camera.size.height;
  if (map.channels() != 1 || camera.has_distortion() || su > 1 || std::abs(su - sv) * map.width() > 2) {
    throw input_error(path.string() + " has " + std::to_string(map.width()) + " x " + std::to_string(map.height()) +
                      " pixels and " + std::to_string(map.channels()) +
                      " channels, expected the shape of its camera, " + std::to_string(camera.size.width) + " x " +
                      std::to_string(camera.size.height) + ", or smaller, and a camera without distortion");
  }
  const Pinhole full = camera.pinhole();
  return {map.size(), full.fx * su, full.fy * sv, (full.cx + 0.5) * su - 0.5, (full.cy + 0.5) * sv - 0.5};
}

}  // namespace

std::vector<fs::path> colmap_workspace_files(const fs::path& folder) {
  std::vector<fs::path> files;
  for (const char* name : {"cameras.bin", "images.bin", "cameras.txt", "images.txt"}) {
    if (fs::exists(folder / "sparse" / name)) files.push_back(folder / "sparse" / name);
  }
  for (const auto& [image, path] : depth_maps(folder)) {
    files.push_back(path);
    if (fs::exists(normal_map_of(folder, image))) files.push_back(normal_map_of(folder, image));
  }
  return files;
}

PointCloud read_colmap_workspace(const fs::path& folder, const Context& context, std::size_t largest_count) {
  const auto maps = depth_maps(folder);
  const ColmapModel model = read_colmap_model(folder / "sparse", ColmapParts::cameras_and_images);
  // Not the cameras' pixels: maps may be much smaller. Their headers have a few bytes only.
  double pixels = 0;
  for (const auto& [name, path] : maps)
    pixels += static_cast<double>(require_file(path, "COLMAP depth map") / sizeof(float));
  const int step = std::max(1, static_cast<int>(std::ceil(std::sqrt(pixels / static_cast<double>(largest_count)))));

  PointCloud cloud;
  for (const auto& [name, path] : maps) {
    context.check_cancel();
    const ColmapImage& image = model.image(name, path.string());
    const Image<float> depth = read_colmap_array(path);
    const Pinhole camera = camera_of_map(model.cameras.at(image.camera_id), depth, path);
    const fs::path normal_path = normal_map_of(folder, name);
    Image<float> normals;
    if (fs::exists(normal_path)) {
      normals = read_colmap_array(normal_path);
      if (normals.size() != depth.size() || normals.channels() != 3) {
        throw input_error(normal_path.string() + " has another shape than " + path.string() +
                          ", expected its size and 3 channels");
      }
    }
    for (int v = step / 2; v < depth.height(); v += step) {
      for (int u = step / 2; u < depth.width(); u += step) {
        const double z = depth(u, v);
        if (!std::isfinite(z) || z <= 0) continue;
        cloud.points.push_back(image.pose.world_from_cam(z * camera.ray(u, v)));
        Eigen::Vector3f normal = Eigen::Vector3f::Zero();  // zero = not known
        if (!normals.empty()) normal = {normals(u, v, 0), normals(u, v, 1), normals(u, v, 2)};
        if (!normal.allFinite()) normal.setZero();
        cloud.normals.push_back(image.pose.rotation.transpose().cast<float>() * normal);
      }
    }
  }
  if (std::all_of(cloud.normals.begin(), cloud.normals.end(), [](const auto& n) { return n.isZero(); })) {
    cloud.normals.clear();
  }
  return cloud;
}

PointCloud read_cloud(const fs::path& path, const Context& context) {
  return fs::is_directory(path) ? read_colmap_workspace(path, context) : read_point_cloud(path, context);
}

}  // namespace malus
