#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>

#include "io/temporary_folder.h"
#include "malus/io/glb_file.h"
#include "malus/io/image_file.h"
#include "malus/io/input_file.h"
#include "malus/surface/dem_file.h"
#include "malus/surface/display_image.h"
#include "malus/surface/mesh.h"
#include "surface/scenes.h"

namespace malus {
namespace {

using namespace scenes;

FusedSurface ball() {
  const Pinhole camera = centred_camera({80, 60}, 1000);
  return surface_of(camera.size, 1000, [&](int u, int v) { return sphere_depth(camera, {0, 0, 900}, 400, u, v); });
}

TEST(DisplayImage, WhiteIsThePercentileAndGreyIsEncoded) {
  Image<float> color({10, 10}, 1, 0.5f), depth({10, 10}, 1, 1.0f);
  color(0, 0) = 0.25f;
  color(1, 0) = none;
  color(2, 0) = 7;
  const Image<std::uint8_t> display = display_image(color, depth, 90, {});
  EXPECT_EQ(display.channels(), 3);
  EXPECT_EQ(display(5, 5, 1), 255);
  EXPECT_EQ(display(0, 0, 2), 188);  // sRGB of one half
  EXPECT_EQ(display(1, 0), 0);
  EXPECT_EQ(display(2, 0), 255);
}

TEST(DisplayImage, FitsWithinASideByAveragingWholeBlocks) {
  Image<std::uint8_t> image({7, 4}, 1, 100);
  image(0, 0) = 104;
  image(6, 3) = 10;
  const Image<std::uint8_t> small = fit_within(image, 4, {});
  EXPECT_EQ(small.size(), (Size{4, 2}));
  EXPECT_EQ(small(0, 0), 101);
  EXPECT_EQ(small(3, 1), 55);  // the last column has two rows of one pixel
  EXPECT_EQ(fit_within(image, 7, {}), image);
}

TEST(Subsample, FollowsTheTriangles) {
  SurfaceOptions options;
  EXPECT_EQ(subsample_for(1000, 1000, options), 1);
  EXPECT_EQ(subsample_for(1001, 1000, options), 2);
  options.subsample = 2;
  EXPECT_EQ(subsample_for(9000, 1000, options), 6);
  EXPECT_EQ(subsample_for(1u << 30, 100, options), 64);
}

TEST(Dem, FileHoldsTheRaster) {
  const TemporaryFolder folder;
  const FusedSurface surface = ball();
  const Dem dem = dem_from_mesh(mesh_from_depth(surface, {}, {}, {}), surface, {}, {});
  write_dem(folder / "dem.tif", dem, length_unit("mm"), "ball <a & b>");
  const Image<float> read = read_float_raster(folder / "dem.tif");
  ASSERT_EQ(read.size(), dem.elevation.size());
  for (std::size_t i = 0; i < read.count(); ++i)
    ASSERT_TRUE(read[i] == dem.elevation[i] || (std::isnan(read[i]) && std::isnan(dem.elevation[i])));
  const std::string bytes = read_file(folder / "dem.tif", "dem");
  EXPECT_NE(bytes.find("WORLD_X_AXIS"), std::string::npos);
  EXPECT_NE(bytes.find("ball <a & b>: plane"), std::string::npos);
  EXPECT_THROW(length_unit("furlong"), Error);
}

TEST(Glb, IsInMetresAndItsTextureLiesOnThePixelGrid) {
  const TemporaryFolder folder;
  const FusedSurface surface = ball();
  const TriangleMesh mesh = mesh_from_depth(surface, {}, {}, {});
  const Image<std::uint8_t> texture({80, 60}, 3, 128);
  write_glb(folder / "ball.glb", mesh, {texture, surface.camera, surface.pose}, length_unit("mm"), "ball");
  const std::string bytes = read_file(folder / "ball.glb", "glb");
  std::array<std::uint32_t, 5> header;
  std::memcpy(header.data(), bytes.data(), sizeof header);
  EXPECT_EQ(header[2], bytes.size());
  const auto json = nlohmann::json::parse(bytes.substr(20, header[3]));
  const char* binary = bytes.data() + 28 + header[3];
  const auto floats = [&](int accessor) {
    const auto& view = json["bufferViews"][json["accessors"][accessor]["bufferView"].get<std::size_t>()];
    std::vector<float> values(view["byteLength"].get<std::size_t>() / 4);
    std::memcpy(values.data(), binary + view["byteOffset"].get<std::size_t>(), values.size() * 4);
    return values;
  };
  const auto& attributes = json["meshes"][0]["primitives"][0]["attributes"];
  const std::vector<float> positions = floats(attributes["POSITION"]), uv = floats(attributes["TEXCOORD_0"]);
  const auto middle = json["nodes"][0]["translation"].get<std::vector<double>>();
  ASSERT_EQ(positions.size(), 3 * mesh.vertices.points.size());
  std::set<int> columns;
  for (std::size_t i = 0; i < mesh.vertices.points.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c)
      ASSERT_NEAR(1000 * (positions[3 * i + c] + middle[c]), mesh.vertices.points[i][static_cast<int>(c)], 1e-4);
    const double column = uv[2 * i] * 80 - 0.5;
    ASSERT_NEAR(column, std::round(column), 1e-3);
    columns.insert(static_cast<int>(std::lround(column)));
  }
  EXPECT_EQ(*columns.begin(), 0);
  EXPECT_EQ(*columns.rbegin(), 79);
}

TEST(Glb, RefusesAMeshThatHasNoTriangles) {
  const TemporaryFolder folder;
  const FusedSurface surface = ball();
  const Image<std::uint8_t> texture({80, 60}, 3, 128);
  expect_error(
      ErrorCode::input,
      [&] {
        write_glb(folder / "none.glb", {}, {texture, surface.camera, surface.pose}, length_unit("mm"), "none");
      },
      "no triangles");
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
}

}  // namespace
}  // namespace malus
