#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "io/temporary_folder.h"
#include "malus/core/depth_normals_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/io/glb_file_internal.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/input_file_internal.h"
#include "malus/io/ply_writer_internal.h"
#include "malus/io/point_cloud_file_internal.h"
#include "malus/surface/dem_internal.h"
#include "malus/surface/display_image_internal.h"
#include "malus/surface/mesh.h"
#include "surface/scenes.h"
#include "thrown_error.h"

namespace malus {
namespace {

using namespace scenes;

FusedSurface ball() {
  const Pinhole camera = centered_camera({80, 60}, 1000);
  return surface_of(camera.size, 1000, [&](int u, int v) { return sphere_depth(camera, {0, 0, 900}, 400, u, v); });
}

TEST(DisplayImage, WhiteIsThePercentileAndGrayIsSrgbEncoded) {
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

TEST(DisplayImage, FitsWithinAMaximumSideByAveragingBlocks) {
  Image<float> color({7, 4}, 1, 0.25f);
  color(6, 0) = 1;  // defines white, so that the other pixels are darker
  color(0, 0) = 0;
  const Image<float> depth(color.size(), 1, 1.0f);
  const Image<std::uint8_t> full = display_image(color, depth, 100, {}),
                            small = display_image(color, depth, 100, {}, 4);
  ASSERT_EQ(full(1, 1), 137);  // sRGB of one quarter
  EXPECT_EQ(small.size(), (Size{4, 2}));
  EXPECT_EQ(small(0, 0, 2), (3 * 137 + 2) / 4);
  EXPECT_EQ(small(3, 0), (255 + 137 + 1) / 2);  // the last block is one pixel wide and two high
  EXPECT_EQ(small(3, 1), 137);
  EXPECT_EQ(display_image(color, depth, 100, {}, 7), full);
}

TEST(DisplayImage, TexturesHaveTheObjectsColorBesideIt) {
  // A gray image with a mask was black there, which darkened the rim where a viewer shows the object small.
  Image<float> color({50, 31}, 1, none);
  const Image<float> depth(color.size(), 1, 1.0f);
  for_each_pixel(PixelRect{3, 5, 22, 20}, [&](int u, int v) { color(u, v) = u < 12 ? 1.0f : 0.25f; });
  for (const int longest_side : {50, 7}) {
    const Image<std::uint8_t> texture = display_texture(color, depth, 100, {}, longest_side);
    EXPECT_GE(*std::ranges::min_element(texture), 137) << longest_side;
    EXPECT_EQ(texture(0, 0, 1), 255);
    EXPECT_EQ(longest_side == 50 ? texture(22, 10) : texture(3, 1), 137) << "just to the right of it";
  }
  EXPECT_EQ(display_image(color, depth, 100, {})(0, 0), 0);
  const Image<float> nothing(color.size(), 1, none);
  EXPECT_EQ(display_texture(nothing, depth, 100, {}), display_image(nothing, depth, 100, {}));
}

/// A ball in front of a wall, with holes, large enough for many strips of different sizes.
FusedSurface ball_and_wall() {
  const Pinhole camera = centered_camera({901, 640}, 1200);
  FusedSurface surface = surface_of(camera.size, 1200, [&](int u, int v) {
    const float ball = sphere_depth(camera, {10, -20, 900}, 150, u, v);
    return std::isfinite(ball) ? ball : plane_depth(camera, {0.1, -0.2, 1}, 1100, u, v);
  });
  surface.normals = normals_from_depth(surface.depth, camera, {});
  for (int v = 100; v < 400; ++v) surface.depth(v + 20, v) = none;
  for (int u = 0; u < 901; ++u) surface.depth(u, 333) = surface.depth(u, 334) = none;
  for (int v = 500; v < 530; ++v) {
    for (int u = 0; u < 901; ++u) surface.normals(u, v) = none;
  }
  return surface;
}

Image<float> gradient(Size size) {
  Image<float> color(size, 3);
  for (std::size_t i = 0; i < color.count(); ++i) color[i] = static_cast<float>(i % 977) / 977;
  return color;
}

TEST(Strips, GiveTheFilesOfTheWholeMeshWithAnyNumberOfThreads) {
  const TemporaryFolder folder;
  const FusedSurface surface = ball_and_wall();
  const Image<float> color = gradient(surface.depth.size());
  const Context three{.threads = 3};
  for (const int subsample : {1, 3}) {
    SurfaceOptions options;
    options.subsample = subsample;
    const MeshInStrips strips = mesh_in_strips(surface, color, options, three);
    ASSERT_GT(strips.strips, 4u);
    const TriangleMesh mesh = mesh_from_depth(surface, color, options, {});
    EXPECT_EQ(strips.vertices, mesh.vertices.points.size());
    EXPECT_EQ(strips.triangles, mesh.triangles.size());
    for (const auto& triangle : mesh.triangles) ASSERT_LT(std::ranges::max(triangle), strips.vertices);
    write_ply(folder / "strips.ply", strips, three);
    write_ply(folder / "whole.ply", mesh);
    EXPECT_EQ(read_file(folder / "strips.ply", "mesh"), read_file(folder / "whole.ply", "mesh"));

    const Dem a = dem_from_mesh(strips, surface, options, three), b = dem_from_mesh(mesh, surface, options, {});
    EXPECT_EQ(a.pixel, b.pixel);
    EXPECT_LT((a.origin - b.origin).norm(), 1e-9);
    ASSERT_EQ(a.elevation.size(), b.elevation.size());
    for (std::size_t i = 0; i < a.elevation.count(); ++i) {
      ASSERT_TRUE(a.elevation[i] == b.elevation[i] || (std::isnan(a.elevation[i]) && std::isnan(b.elevation[i])));
    }
  }
}

TEST(Strips, FarFromTheOriginHaveDoubleCoordinatesLikeTheWholeMesh) {
  const TemporaryFolder folder;
  FusedSurface surface = ball_and_wall();
  surface.pose.translation += Eigen::Vector3d(4e6, 5e6, 0);
  write_ply(folder / "strips.ply", mesh_in_strips(surface, {}, {}, {}), {});
  write_ply(folder / "whole.ply", mesh_from_depth(surface, {}, {}, {}));
  const std::string bytes = read_file(folder / "strips.ply", "mesh");
  EXPECT_NE(bytes.find("property double x"), std::string::npos);
  EXPECT_EQ(bytes, read_file(folder / "whole.ply", "mesh"));
}

TEST(Subsample, GrowsWithTheNumberOfTriangles) {
  SurfaceOptions options;
  EXPECT_EQ(subsample_for(1000, 1000, options), 1);
  EXPECT_EQ(subsample_for(1001, 1000, options), 2);
  options.subsample = 2;
  EXPECT_EQ(subsample_for(9000, 1000, options), 6);
  EXPECT_EQ(subsample_for(1u << 30, 100, options), 64);
}

TEST(Subsample, LeavesSomethingOfAThinRing) {
  const FusedSurface ring = surface_of({301, 301}, 1000, [](int u, int v) {
    return std::abs(std::hypot(u - 150, v - 150) - 130) < 2.5 ? 500.0 : double{none};
  });
  SurfaceOptions options;
  options.glb_triangles = 100;
  const std::size_t triangles = mesh_from_depth(ring, {}, options, {}).triangles.size();
  options.subsample = subsample_for(triangles, options.glb_triangles, options);
  EXPECT_THROW(mesh_from_depth(ring, {}, options, {}), Error);
  options.subsample = 1;
  options.subsample = subsample_for_glb(ring, triangles, options, {});
  EXPECT_FALSE(mesh_from_depth(ring, {}, options, {}).triangles.empty());
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
  Dem in_a_grid = dem;
  in_a_grid.origin = {5432123456.789, 432123456.125, 90.5};
  write_dem(folder / "grid.tif", in_a_grid, length_unit("mm"), "ball");
  EXPECT_NE(read_file(folder / "grid.tif", "dem").find(">5432123456.789 432123456.125 90.5<"), std::string::npos);
  EXPECT_THROW(length_unit("furlong"), Error);
}

TEST(Dem, FileKeepsItsPlaceInANationalGrid) {
  const TemporaryFolder folder;
  Dem dem;
  dem.elevation = Image<float>({2, 2}, 1, 0.5f);
  dem.pixel = 10;
  dem.origin = {4.123456789123e11, 5.412345678912345e12, 321.25};  // micrometers
  write_dem(folder / "dem.tif", dem, length_unit("um"), "stone");
  const std::string bytes = read_file(folder / "dem.tif", "dem"), name = "WORLD_ORIGIN\">";
  const std::size_t at = bytes.find(name);
  ASSERT_NE(at, std::string::npos);
  std::istringstream numbers(bytes.substr(at + name.size(), 80));
  for (int axis = 0; axis < 3; ++axis) {
    double value = 0;
    numbers >> value;
    EXPECT_NEAR(value, dem.origin[axis], 1e-3 * dem.pixel) << axis;
  }
}

/// The values of an attribute of the mesh in a GLB file.
std::vector<float> attribute_of(const std::string& bytes, const char* name) {
  std::uint32_t length = 0;
  std::memcpy(&length, bytes.data() + 12, sizeof length);
  const auto json = nlohmann::json::parse(bytes.substr(20, length));
  const auto accessor = json["meshes"][0]["primitives"][0]["attributes"][name].get<std::size_t>();
  const auto& view = json["bufferViews"][json["accessors"][accessor]["bufferView"].get<std::size_t>()];
  std::vector<float> values(view["byteLength"].get<std::size_t>() / 4);
  std::memcpy(values.data(), bytes.data() + 28 + length + view["byteOffset"].get<std::size_t>(), values.size() * 4);
  return values;
}

TEST(Glb, IsInMetersAndItsTextureLiesOnThePixelGrid) {
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
  const std::vector<float> positions = attribute_of(bytes, "POSITION"), uv = attribute_of(bytes, "TEXCOORD_0");
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

TEST(Glb, AReducedTextureLiesOnThePixelGridUpToTheFarSides) {
  const TemporaryFolder folder;
  const FusedSurface surface = ball();
  const TriangleMesh mesh = mesh_from_depth(surface, {}, {}, {});
  // Three pixels to a texel: the last of 27 columns is two pixels wide.
  const int texel_px = display_block(surface.camera.size, 27);
  const Image<std::uint8_t> texture = display_image(Image<float>({80, 60}, 1, 0.5f), surface.depth, 99, {}, 27);
  ASSERT_EQ(texel_px, 3);
  ASSERT_EQ(texture.size(), (Size{27, 20}));
  write_glb(folder / "ball.glb", mesh, {texture, surface.camera, surface.pose, texel_px}, length_unit("mm"), "ball");
  const std::vector<float> uv = attribute_of(read_file(folder / "ball.glb", "glb"), "TEXCOORD_0");
  int last = 0;
  for (std::size_t i = 0; i < uv.size(); i += 2) {
    const double column = uv[i] * 81 - 0.5;
    ASSERT_NEAR(column, std::round(column), 1e-3);
    last = std::max(last, static_cast<int>(std::lround(column)));
  }
  EXPECT_EQ(last, 79);
}

TEST(MeshFiles, OfManyPartsAreTheSameWithAnyNumberOfThreads) {
  const TemporaryFolder folder;
  const FusedSurface surface = ball();
  TriangleMesh mesh;
  constexpr std::uint32_t count = 200'003;
  for (std::uint32_t i = 0; i < count; ++i) {
    mesh.vertices.points.emplace_back(0.1 * i, std::sin(0.01 * i), 400);
    mesh.vertices.normals.emplace_back(0.0F, 0.6F, -0.8F);
    mesh.triangles.push_back({i, (i + 1) % count, (i + 7) % count});
  }
  const Image<std::uint8_t> texture({80, 60}, 3, 128);
  const Context three{.threads = 3};
  for (const auto& [name, context] : {std::pair("one", Context{}), std::pair("three", three)}) {
    write_ply(folder / (std::string(name) + ".ply"), mesh, context);
    write_glb(folder / (std::string(name) + ".glb"), mesh, {texture, surface.camera, surface.pose}, length_unit("mm"),
              "mesh", context);
  }
  for (const char* kind : {".ply", ".glb"}) {
    const std::string one = read_file(folder / (std::string("one") + kind), "mesh");
    EXPECT_GT(one.size(), 3u << 20);
    EXPECT_TRUE(one == read_file(folder / (std::string("three") + kind), "mesh")) << kind;
  }
  EXPECT_EQ(read_mesh(folder / "three.ply").triangles, mesh.triangles);
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
