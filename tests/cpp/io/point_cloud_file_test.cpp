#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>

#include "malus/io/input_file_internal.h"
#include "malus/io/ply_writer_internal.h"
#include "malus/io/point_cloud_file_internal.h"
#include "shared_data.h"
#include "temporary_folder.h"
#include "thrown_error.h"

namespace malus {
namespace {

template <class T>
void append(std::string& bytes, T value, bool big_endian = false) {
  char raw[sizeof value];
  std::memcpy(raw, &value, sizeof value);
  if (big_endian) std::reverse(raw, raw + sizeof value);
  bytes.append(raw, sizeof value);
}

TriangleMesh tetrahedron() {
  TriangleMesh mesh;
  mesh.vertices.points = {{0, 0, 0}, {1.5, 0, 0}, {0, 2.25, 0}, {0, 0, -3}};
  mesh.vertices.normals = {{0, 0, 1}, {1, 0, 0}, {0, 1, 0}, {0, 0, -1}};
  mesh.vertices.colors = {{1, 2, 3}, {255, 0, 128}, {4, 5, 6}, {7, 8, 9}};
  mesh.triangles = {{0, 1, 2}, {0, 3, 1}, {1, 3, 2}};
  return mesh;
}

TEST(PointCloudFile, WrittenPlyIsReadBackUnchanged) {
  const TemporaryFolder folder;
  const TriangleMesh mesh = tetrahedron();
  write_ply(folder / "mesh.ply", mesh);
  const TriangleMesh back = read_mesh(folder / "mesh.ply");
  EXPECT_EQ(back.vertices.points, mesh.vertices.points);
  EXPECT_EQ(back.vertices.normals, mesh.vertices.normals);
  EXPECT_EQ(back.vertices.colors, mesh.vertices.colors);
  EXPECT_EQ(back.triangles, mesh.triangles);
  PointCloud bare;
  bare.points = mesh.vertices.points;
  write_ply(folder / "cloud.ply", TriangleMesh{bare, {}});
  const PointCloud cloud = read_point_cloud(folder / "cloud.ply");
  EXPECT_EQ(cloud.points, bare.points);
  EXPECT_TRUE(cloud.normals.empty());
  EXPECT_TRUE(cloud.colors.empty());
  bare.colors.resize(2);
  expect_error(
      ErrorCode::input,
      [&] {
        write_ply(folder / "x.ply", TriangleMesh{bare, {}});
      },
      "4 points", "2 colors");
}

TEST(PointCloudFile, CoordinatesAreDoubleWhereFloatWouldLoseDetail) {
  const TemporaryFolder folder;
  PointCloud near, far;
  for (int i = 0; i < 10000; ++i) {
    const Eigen::Vector3d point(0.1 * (i % 100), 0.1 * (i / 100), 600.0);
    near.points.push_back(point);
    far.points.push_back(point + Eigen::Vector3d(2600000.123, 1200000.456, 0));
  }
  write_ply(folder / "near.ply", TriangleMesh{near, {}});
  write_ply(folder / "far.ply", TriangleMesh{far, {}});
  EXPECT_NE(read_file(folder / "near.ply", "cloud").find("property float x"), std::string::npos);
  EXPECT_NE(read_file(folder / "far.ply", "cloud").find("property double x"), std::string::npos);
  EXPECT_EQ(read_point_cloud(folder / "far.ply").points, far.points);
  const PointCloud back = read_point_cloud(folder / "near.ply");
  double largest = 0;
  for (std::size_t i = 0; i < near.points.size(); ++i)
    largest = std::max(largest, (back.points[i] - near.points[i]).norm());
  EXPECT_LT(largest, 1e-3 * 0.1) << "a thousandth of the spacing";
}

TEST(PointCloudFile, ReadsBinaryOfBothByteOrdersWithAnyLayout) {
  const TemporaryFolder folder;
  for (const bool big : {false, true}) {
    std::string bytes =
        std::string("ply\nformat ") + (big ? "binary_big_endian" : "binary_little_endian") +
        " 1.0\ncomment hello\nobj_info x\nelement camera 2\nproperty int id\nelement strange 2\n"
        "property list uchar short s\nproperty char c\nelement vertex 2\nproperty ushort green\n"
        "property ushort blue\nproperty double z\nproperty list int float extra\nproperty float confidence\n"
        "property ushort red\nproperty float x\nproperty int y\nend_header\n";
    for (int i = 0; i < 2; ++i) append(bytes, std::int32_t{i}, big);
    for (int i = 0; i < 2; ++i) {
      append(bytes, std::uint8_t{2});
      append(bytes, std::int16_t{1}, big);
      append(bytes, std::int16_t{2}, big);
      append(bytes, std::int8_t{3});
    }
    for (int i = 0; i < 2; ++i) {
      append(bytes, std::uint16_t{65535}, big);
      append(bytes, std::uint16_t{257}, big);
      append(bytes, 1e9 + i, big);
      append(bytes, std::int32_t{i}, big);
      for (int k = 0; k < i; ++k) append(bytes, 7.0f, big);
      append(bytes, 0.5f, big);
      append(bytes, std::uint16_t{0}, big);
      append(bytes, -2.5f, big);
      append(bytes, std::int32_t{-4 * i}, big);
    }
    const PointCloud cloud = read_point_cloud(folder.write("a.ply", bytes));
    ASSERT_EQ(cloud.points.size(), 2u);
    EXPECT_EQ(cloud.points[1], Eigen::Vector3d(-2.5, -4, 1e9 + 1));
    EXPECT_EQ(cloud.colors[0], (Rgb{0, 255, 1}));
    EXPECT_TRUE(cloud.normals.empty());
  }
}

TEST(PointCloudFile, ReadsAsciiPlyWithPolygons) {
  const TemporaryFolder folder;
  const std::string header =
      "ply\r\nformat ascii 1.0\r\nelement vertex 5\r\nproperty float y\r\nproperty float x\r\nproperty float z\r\n"
      "property float red\r\nproperty float green\r\nproperty float blue\r\nelement face 2\r\n"
      "property list uchar int vertex_index\r\nend_header\r\n";
  const std::string vertices =
      "0 0 0 0 0.5 1\r\n0 1 0 1 1 1\r\n\r\n1 1 0 0 0 0\r\n1 0 0 0 0 0\r\n 2 +0.5 1e-1 0 0 0\r\n";
  const TriangleMesh mesh = read_mesh(folder.write("a.ply", header + vertices + "4 0 1 2 3\r\n3 3 2 4"));
  EXPECT_EQ(mesh.vertices.points[4], Eigen::Vector3d(0.5, 2, 0.1));
  EXPECT_EQ(mesh.vertices.colors[0], (Rgb{0, 128, 255}));
  EXPECT_EQ(mesh.triangles, (std::vector<std::array<std::uint32_t, 3>>{{0, 1, 2}, {0, 2, 3}, {3, 2, 4}}));
  const auto rejects = [&](const std::string& rest, const auto&... parts) {
    folder.write("a.ply", header + rest);
    expect_error(
        ErrorCode::input, [&] { read_mesh(folder / "a.ply"); }, "mesh", "a.ply", parts...);
  };
  rejects(vertices + "4 0 1 2 3\n3 3 2 5\n", "face 1", "vertex index 5", "0 to 4");
  rejects(vertices + "4 0 1 2 3\n3 3 -1 4\n", "vertex index -1");
  rejects(vertices + "4 0 1 2 3\n9 3 2 4\n", "line", "expected numbers");
  rejects(vertices + "4 0 1 2 3\n", "truncated");
  rejects(vertices, "claims 2 elements \"face\"");
  rejects("0 0 zero 0 0 0\n" + vertices, "line 13", "zero");
  rejects("0,5 0,5 0,5 0 0 0\n" + vertices, "line 13", "0,5");
}

TEST(PointCloudFile, ReadsXyzText) {
  const TemporaryFolder folder;
  const auto cloud = [&](const std::string& text) { return read_point_cloud(folder.write("a.xyz", text)); };
  EXPECT_EQ(cloud("1 2 3\n4 5 6\n").points[1], Eigen::Vector3d(4, 5, 6));
  EXPECT_EQ(cloud("# made by hand\n// x\n\n1,2,3\n4;5;6\n").points[1], Eigen::Vector3d(4, 5, 6));
  EXPECT_EQ(cloud("1 2 3 9 9\n").points[0], Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(cloud("2\n1 2 3\n4 5 6\n").points.size(), 2u) << "a PTS file starts with its count";
  EXPECT_EQ(cloud("1 2 3 255 0 10\n").colors[0], (Rgb{255, 0, 10}));
  EXPECT_EQ(cloud("1 2 3 0 0 1\n").normals[0], Eigen::Vector3f(0, 0, 1));
  EXPECT_EQ(cloud("1 2 3 0.6 0 0.8\n").normals[0], Eigen::Vector3f(0.6f, 0, 0.8f));
  const PointCloud nine = cloud("1 2 3 10 20 30 0 1 0\n");
  EXPECT_EQ(nine.colors[0], (Rgb{10, 20, 30}));
  EXPECT_EQ(nine.normals[0], Eigen::Vector3f(0, 1, 0));
  const PointCloud named = cloud("//X Y Z Intensity Nx Ny Nz R G B\n1 2 3 77 0 1 0 10 20 30\n");
  EXPECT_EQ(named.colors[0], (Rgb{10, 20, 30}));
  EXPECT_EQ(named.normals[0], Eigen::Vector3f(0, 1, 0));
  EXPECT_EQ(cloud("z y x\n1 2 3\n").points[0], Eigen::Vector3d(3, 2, 1));
  EXPECT_EQ(cloud("easting northing height\n1 2 3\n").points[0], Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(cloud("ID,X,Y,Z\n7,1.5,2.5,3.5\n").points[0], Eigen::Vector3d(1.5, 2.5, 3.5));
  EXPECT_EQ(cloud("# seen from x y z\n1 2 3 4 5 6\n").points[0], Eigen::Vector3d(1, 2, 3)) << "text, no names";
  EXPECT_EQ(cloud("\"z\",\"y\",\"x\"\n1,2,3\n").points[0], Eigen::Vector3d(3, 2, 1));
  EXPECT_EQ(cloud("\xef\xbb\xbfz;y;x\n1;2;3\n").points[0], Eigen::Vector3d(3, 2, 1)) << "with a byte order mark";
  EXPECT_EQ(cloud("1,2,3 10,20,30\n").colors[0], (Rgb{10, 20, 30}));
  EXPECT_EQ(cloud("1,2,3, 10,20,30\n").colors[0], (Rgb{10, 20, 30}));
  EXPECT_EQ(cloud("# scan 7\nz y x\n1 2 3\n").points[0], Eigen::Vector3d(3, 2, 1)) << "names below a comment";
  EXPECT_EQ(cloud("//Z Y X\n2\n1 2 3\n4 5 6\n").points[1], Eigen::Vector3d(6, 5, 4)) << "as of CloudCompare";
  const auto rejects = [&](const std::string& text, const auto&... parts) {
    expect_error(
        ErrorCode::input, [&] { cloud(text); }, "a.xyz", parts...);
  };
  rejects("1 2 3\n4 5\n", "line 2", "4 5");
  rejects("1 2 3\nx y z\n", "line 2");
  rejects("1 2 3 255 0 10\n1 2 3\n", "line 2");
  rejects("x;y;z\n1,5;2,25;3,75\n", "line 2", "1,5;2,25;3,75", "decimal points");
  rejects("1,5\t2,25\t-3,75\n", "line 1", "decimal points");
  rejects("1;2;3\n1,5;2;3\n", "line 2", "decimal points");
  rejects("1,5, 2,25, 3,75\n", "line 1", "decimal points");
  rejects("1\n2\n3\n", "line 2", "expected numbers");
  rejects("# nothing\n", "no points");
  rejects(std::string("\x7f"
                      "ELF\0\1\2",
                      7),
          "neither PLY nor text");
}

TEST(PointCloudFile, ColumnsWithoutNamesAreToldByAllLines) {
  const TemporaryFolder folder;
  const auto cloud = [&](const std::string& text) { return read_point_cloud(folder.write("a.xyz", text)); };
  const PointCloud shares = cloud("1 2 3 0.2 0.6 1.0\n4 5 6 0 0 0\n7 8 9 1 0 0.5\n");
  EXPECT_TRUE(shares.normals.empty()) << "as of Open3D's xyzrgb";
  ASSERT_EQ(shares.colors.size(), 3u);
  EXPECT_EQ(shares.colors[0], (Rgb{51, 153, 255}));
  EXPECT_EQ(shares.colors[2], (Rgb{255, 0, 128}));
  EXPECT_EQ(cloud("1 2 3 0 0 0\n4 5 6 65535 0 257\n").colors[1], (Rgb{255, 0, 1}));
  const PointCloud unknown = cloud("1 2 3 0 0 0\n4 5 6 0.6 -0.8 0\n");
  EXPECT_TRUE(unknown.colors.empty()) << "the first normal is unknown";
  EXPECT_EQ(unknown.normals[1], Eigen::Vector3f(0.6f, -0.8f, 0));
  EXPECT_EQ(cloud("1 2 3 0.6 0 0.8\n4 5 6 0 0 0\n7 8 9 0 0.8 0.6\n").normals.size(), 3u) << "none is negative";
  EXPECT_EQ(cloud("x y z r g b\n1 2 3 0.2 0.6 1\n").colors[0], (Rgb{51, 153, 255}));
}

TEST(PointCloudFile, NineColumnsWithoutNamesHaveNormalsAndColorsInEitherOrder) {
  const TemporaryFolder folder;
  const Eigen::Vector3f normal(0.6F, -0.8F, 0);
  const auto check = [&](const std::string& text, std::size_t i, const Rgb& color) {
    const PointCloud cloud = read_point_cloud(folder.write("a.xyz", text));
    ASSERT_EQ(cloud.normals.size(), cloud.points.size()) << text;
    ASSERT_EQ(cloud.colors.size(), cloud.points.size()) << text;
    EXPECT_EQ(cloud.normals[i], normal) << text;
    EXPECT_EQ(cloud.colors[i], color) << text;
  };
  check("1 2 3 0.6 -0.8 0 10 20 30\n", 0, {10, 20, 30});
  check("1 2 3 10 20 30 0.6 -0.8 0\n", 0, {10, 20, 30});
  // Normals of the first line that could be colors of bytes.
  for (const std::string& first : {std::string("0 0 1"), std::string("1 0 0"), std::string("0 0 0")}) {
    check("1 2 3 " + first + " 200 100 50\n4 5 6 0.6 -0.8 0 10 20 30\n", 1, {10, 20, 30});
    check("1 2 3 0.2 0.6 1.0 " + first + "\n4 5 6 1 0 0.2 0.6 -0.8 0\n", 1, {255, 0, 51});
  }
  check("1 2 3 0 0 1 0.2 0.6 1.0\n4 5 6 0.6 -0.8 0 1 0 0.2\n", 1, {255, 0, 51});
  check("1 2 3 0.6 -0.8 0 0 0 0\n", 0, {0, 0, 0});
  check("1 2 3 1 0 0 0.6 -0.8 0\n", 0, {255, 0, 0});
  const PointCloud none_negative = read_point_cloud(folder.write("a.xyz", "1 2 3 0 0.6 0.8 10 20 30\n"));
  EXPECT_EQ(none_negative.normals[0], Eigen::Vector3f(0, 0.6F, 0.8F)) << "of length 1";
}

TEST(PointCloudFile, NumbersOfPointsAreNoCoordinates) {
  const TemporaryFolder folder;
  std::string numbered = "", named = "id x y z\n", profile = "";
  for (int i = 0; i < 12; ++i) {
    const std::string line = std::to_string(101 + i) + " 7.5 " + std::to_string(i * i) + " 3.25\n";
    numbered += line;
    named += line;
    profile += std::to_string(i) + " 0 2.5\n";
  }
  expect_error(
      ErrorCode::input, [&] { read_point_cloud(folder.write("a.txt", numbered)); }, "a.txt", "first column",
      "id x y z");
  EXPECT_EQ(read_point_cloud(folder.write("a.txt", named)).points[3], Eigen::Vector3d(7.5, 9, 3.25));
  EXPECT_EQ(read_point_cloud(folder.write("a.txt", profile)).points.size(), 12u) << "three columns are coordinates";
}

TEST(PointCloudFile, CoordinatesThatAreNotFiniteAreCounted) {
  const TemporaryFolder folder;
  PointCloud cloud;
  cloud.points.assign(10, Eigen::Vector3d(1, 2, 3));
  cloud.points[4].y() = std::numeric_limits<double>::quiet_NaN();
  cloud.points[7].x() = std::numeric_limits<double>::infinity();
  write_ply(folder / "nan.ply", TriangleMesh{cloud, {}});
  expect_error(
      ErrorCode::input, [&] { read_point_cloud(folder / "nan.ply"); }, "nan.ply", "2 of 10", "number 4");
  expect_error(
      ErrorCode::input, [&] { read_point_cloud(folder.write("a.xyz", "1 2 3\n1 nan 3\n")); }, "1 of 2", "number 1");
  cloud.points.assign(1, Eigen::Vector3d(1, 2, 3));
  cloud.normals.assign(1, Eigen::Vector3f(0, std::nanf(""), 0));
  write_ply(folder / "normal.ply", TriangleMesh{cloud, {}});
  EXPECT_EQ(read_point_cloud(folder / "normal.ply").normals[0], Eigen::Vector3f(0, 0, 0));
}

TEST(PointCloudFile, BadHeadersAreInputErrors) {
  const TemporaryFolder folder;
  const auto rejects = [&](const std::string& text, const auto&... parts) {
    expect_error(
        ErrorCode::input, [&] { read_point_cloud(folder.write("a.ply", text)); }, "a.ply", parts...);
  };
  const std::string start = "ply\nformat binary_little_endian 1.0\n";
  const std::string xyz = "property float x\nproperty float y\nproperty float z\n";
  rejects(start + "element vertex 4000000000\n" + xyz + "end_header\nabc", "claims 4000000000", "truncated");
  rejects(start + "element vertex 18446744073709551615\n" + xyz + "end_header\nabc", "claims 18446744073709551615");
  rejects("ply\nformat ascii 1.0\nelement vertex 4000000000\n" + xyz + "end_header\n1 2 3\n", "claims 4000000000");
  rejects(start + "element vertex 1e3\n" + xyz + "end_header\n", "malformed element");
  rejects(start + "element vertex -1\n" + xyz + "end_header\n", "malformed element");
  rejects(start + "element vertex 1\nproperty float x\nproperty float y\nend_header\n12345678", "without z");
  rejects(start + "element vertex 1\nproperty quad x\nend_header\n", "quad");
  rejects(start + "element vertex 1\nproperty float\nend_header\n", "malformed property");
  rejects(start + "element vertex 1\nproperty list float int x\nend_header\n", "floating-point");
  rejects(start + "element vertex 0\n" + xyz + "end_header\n", "no points");
  rejects(start + "element points 0\nend_header\n", "no element vertex");
  rejects("ply\nformat utf7 1.0\nend_header\n", "utf7");
  rejects("ply\nelement vertex 1\n" + xyz + "end_header\n", "no format");
  rejects(start + "element vertex 1\n" + xyz, "without end_header");
  rejects(start + "property float x\nend_header\n", "unknown line");
  rejects("ply\n", "without end_header");
  expect_error(
      ErrorCode::input, [&] { read_point_cloud(folder / "none.ply"); }, "no such file");
  expect_error(
      ErrorCode::input, [&] { read_point_cloud(folder.write("e.ply", "")); }, "is empty");
  expect_error(
      ErrorCode::input, [&] { read_mesh(folder.write("a.xyz", "1 2 3\n")); }, "not a PLY");
  PointCloud cloud;
  cloud.points.assign(3, Eigen::Vector3d(1, 2, 3));
  write_ply(folder / "cloud.ply", TriangleMesh{cloud, {}});
  expect_error(
      ErrorCode::input, [&] { read_mesh(folder / "cloud.ply"); }, "no faces, expected some; points alone are a cloud");
}

TEST(PointCloudFile, TruncatedAndMutatedFilesAreInputErrors) {
  const TemporaryFolder folder;
  write_ply(folder / "mesh.ply", tetrahedron());
  const std::string binary = read_file(folder / "mesh.ply", "mesh");
  const std::string text =
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
      "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
  for (const std::string& bytes : {binary, text}) {
    for (std::size_t length = 0; length < bytes.size() - 2; ++length) {
      expect_error(
          ErrorCode::input, [&] { read_mesh(folder.write("cut.ply", bytes.substr(0, length))); }, "cut.ply");
    }
    std::mt19937 random(11);
    int rejected = 0;
    for (int round = 0; round < 3000; ++round) {
      std::string mutated = bytes;
      for (unsigned i = 0; i <= random() % 3; ++i) {
        const std::size_t at = random() % mutated.size();
        switch (random() % 3) {
          case 0:
            mutated[at] = static_cast<char>(random());
            break;
          case 1:
            mutated[at] = static_cast<char>('0' + random() % 10);
            break;
          default:
            mutated.insert(at, 1, static_cast<char>('0' + random() % 10));
        }
      }
      try {
        read_mesh(folder.write("mutated.ply", mutated));
      } catch (const Error& error) {
        EXPECT_EQ(error.code(), ErrorCode::input) << error.what();
        ++rejected;
      }
    }
    EXPECT_GT(rejected, 1000);
  }
}

TEST(PointCloudFile, StopsWhenCanceled) {
  const TemporaryFolder folder;
  write_ply(folder / "mesh.ply", tetrahedron());
  const std::atomic<bool> cancel{true};
  Context context;
  context.cancel = &cancel;
  expect_error(
      ErrorCode::interrupted, [&] { read_mesh(folder / "mesh.ply", context); }, "interrupted");
}

TEST(PointCloudFile, RenderedCloudLoads) {
  const std::filesystem::path path = shared_data() / "rendered/relief/dense/mvs_cloud.ply";
  if (!std::filesystem::exists(path)) GTEST_SKIP() << path << " is absent";
  const PointCloud cloud = read_point_cloud(path);
  EXPECT_EQ(cloud.points.size(), 59725u);
  EXPECT_EQ(cloud.colors.size(), 59725u);
  for (const Eigen::Vector3f& normal : cloud.normals) ASSERT_NEAR(normal.norm(), 1, 1e-3);
}

TEST(PointCloudFile, ReadsACloudOrAMesh) {
  const TemporaryFolder folder;
  const auto text = folder.write("a.xyz", "0 0 0\n1 0 0\n0 1 0\n");
  EXPECT_EQ(read_cloud_or_mesh(text).vertices.points.size(), 3u);
  EXPECT_TRUE(read_cloud_or_mesh(text).triangles.empty());
  TriangleMesh mesh = read_cloud_or_mesh(text);
  write_ply(folder / "cloud.ply", TriangleMesh{mesh.vertices, {}});
  EXPECT_TRUE(read_cloud_or_mesh(folder / "cloud.ply").triangles.empty());
  mesh.triangles.push_back({0, 1, 2});
  write_ply(folder / "mesh.ply", mesh);
  EXPECT_EQ(read_cloud_or_mesh(folder / "mesh.ply").triangles, mesh.triangles);
}

}  // namespace
}  // namespace malus
