#include <gtest/gtest.h>

#include <fstream>

#include "malus/io/colmap_model_internal.h"
#include "malus/io/colmap_workspace_internal.h"
#include "temporary_folder.h"
#include "thrown_error.h"

namespace malus {
namespace {

namespace fs = std::filesystem;

/// Writes an array in COLMAP's format.
void write_array(const fs::path& path, const Image<float>& image) {
  fs::create_directories(path.parent_path());
  std::ofstream file(path, std::ios::binary);
  file << image.width() << '&' << image.height() << '&' << image.channels() << '&';
  for (int c = 0; c < image.channels(); ++c) {
    for (int v = 0; v < image.height(); ++v) {
      for (int u = 0; u < image.width(); ++u) {
        const float value = image(u, v, c);
        file.write(reinterpret_cast<const char*>(&value), sizeof value);
      }
    }
  }
}

/// Two cameras above the plane z = 0 of the world. Maps have half the images' size; the first has a hole (depth 0).
class Workspace {
 public:
  Workspace() {
    fs::create_directories(root() / "sparse");
    ColmapModel model;
    model.cameras[1] = {LensModel::pinhole, {60, 40}, {80, 80, 29.5, 19.5}};
    for (int i = 0; i < 2; ++i) {
      ColmapImage image{"view_" + std::to_string(i) + ".jpg", 1, {}, {}};
      image.pose.rotation = Eigen::Vector3d(1, -1, -1).asDiagonal();
      image.pose.translation = {i * 2.0, 0, 50};
      Image<float> depth({30, 20}, 1, 50.0F), normals({30, 20}, 3, 0.0F);
      for (int v = 0; v < 20; ++v) {
        for (int u = 0; u < 30; ++u) normals(u, v, 2) = -1;
      }
      if (i == 0) depth(3, 4) = 0;
      write_array(root() / "stereo/depth_maps" / (image.name + ".geometric.bin"), depth);
      write_array(root() / "stereo/normal_maps" / (image.name + ".geometric.bin"), normals);
      model.images[static_cast<std::uint32_t>(i + 1)] = image;
    }
    write_colmap_model(root() / "sparse", model);
  }
  fs::path root() const { return folder_.path(); }

 private:
  TemporaryFolder folder_;
};

TEST(ColmapWorkspace, PixelsBecomePointsWithNormalsInTheWorld) {
  const Workspace workspace;
  const PointCloud cloud = read_colmap_workspace(workspace.root());
  ASSERT_EQ(cloud.points.size(), 2u * 600u - 1u);
  ASSERT_EQ(cloud.normals.size(), cloud.points.size());
  double least = 1e9, most = -1e9;
  for (std::size_t i = 0; i < cloud.points.size(); ++i) {
    EXPECT_NEAR(cloud.points[i].z(), 0, 1e-9);
    EXPECT_LT((cloud.normals[i] - Eigen::Vector3f::UnitZ()).norm(), 1e-6);
    least = std::min(least, cloud.points[i].x());
    most = std::max(most, cloud.points[i].x());
  }
  EXPECT_NEAR(least, -2 - 14.5 / 40 * 50, 1e-6);  // half a pixel of the map inside the image's border
  EXPECT_NEAR(most, 14.5 / 40 * 50, 1e-6);
}

TEST(ColmapWorkspace, ManyPixelsAreThinned) {
  const Workspace workspace;
  const std::size_t all = read_colmap_workspace(workspace.root()).points.size();
  EXPECT_EQ(read_colmap_workspace(workspace.root(), {}, 1300).points.size(), all) << "1200 pixels, of cameras of 4800";
  const std::size_t thinned = read_colmap_workspace(workspace.root(), {}, 310).points.size();
  EXPECT_NEAR(static_cast<double>(thinned), static_cast<double>(all) / 4, 3);
}

TEST(ColmapWorkspace, MissingAndMismatchedMapsAreNamed) {
  const Workspace workspace;
  const TemporaryFolder empty;
  expect_error(
      ErrorCode::input, [&] { read_colmap_workspace(empty.path()); }, "depth_maps");
  fs::create_directories(empty.path() / "stereo/depth_maps");
  std::ofstream(empty.path() / "stereo/depth_maps/a.jpg.photometric.bin") << "x";
  expect_error(
      ErrorCode::input, [&] { read_colmap_workspace(empty.path()); }, "geom_consistency");
  const fs::path stranger = workspace.root() / "stereo/depth_maps/stranger.jpg.geometric.bin";
  write_array(stranger, Image<float>({30, 20}, 1, 50.0F));
  expect_error(
      ErrorCode::input, [&] { read_colmap_workspace(workspace.root()); }, "stranger");
  fs::remove(stranger);
  write_array(workspace.root() / "stereo/depth_maps/view_1.jpg.geometric.bin", Image<float>({30, 30}, 1, 50.0F));
  expect_error(
      ErrorCode::input, [&] { read_colmap_workspace(workspace.root()); }, "60 x 40");
}

}  // namespace
}  // namespace malus
