#include <Eigen/Geometry>
#include <cmath>
#include <cstring>
#include <random>
#include <sstream>

#include "malus/io/colmap_model_internal.h"
#include "malus/io/input_file_internal.h"
#include "shared_data.h"
#include "temporary_folder.h"
#include "thrown_error.h"

namespace malus {
namespace {

Pose some_pose(double angle) {
  Pose pose;
  pose.rotation = Eigen::AngleAxisd(angle, Eigen::Vector3d(0.3, -0.8, 0.5).normalized()).toRotationMatrix();
  pose.translation = {1.25, -3.5, 640.125};
  return pose;
}

ColmapModel some_model() {
  ColmapModel model;
  model.cameras[1] = {LensModel::opencv, {960, 640}, {2152.4, 2150.1, 479.5, 319.25, -0.08, 0.03, 6e-4, -4e-4}};
  model.cameras[7] = {LensModel::simple_radial, {720, 480}, {1937.25, 361.5, 237.0, -0.01}};
  model.images[3] = {"view 00.jpg", 1, some_pose(0.4), {{{10.25, 20.75}, 5}, {{1, 2}, ColmapKeypoint::no_point}}};
  model.images[4] = {"sub/station.jpg", 7, some_pose(3.0), {}};
  model.points[5] = {{0.1, -20.5, 30.25}, {1, 2, 255}, 0.75, {{3, 0}, {4, 11}}};
  return model;
}

void expect_same(const ColmapModel& a, const ColmapModel& b) {
  ASSERT_EQ(a.cameras.size(), b.cameras.size());
  for (const auto& [id, camera] : a.cameras) {
    const LensCamera& other = b.cameras.at(id);
    EXPECT_EQ(camera.model, other.model);
    EXPECT_EQ(camera.size, other.size);
    ASSERT_EQ(camera.params.size(), other.params.size());
    for (std::size_t i = 0; i < camera.params.size(); ++i) EXPECT_NEAR(camera.params[i], other.params[i], 1e-12);
  }
  ASSERT_EQ(a.images.size(), b.images.size());
  for (const auto& [id, image] : a.images) {
    const ColmapImage& other = b.images.at(id);
    EXPECT_EQ(image.name, other.name);
    EXPECT_EQ(image.camera_id, other.camera_id);
    EXPECT_LT((image.pose.rotation - other.pose.rotation).norm(), 1e-14);
    EXPECT_EQ(image.pose.translation, other.pose.translation);
    ASSERT_EQ(image.keypoints.size(), other.keypoints.size());
    for (std::size_t i = 0; i < image.keypoints.size(); ++i) {
      EXPECT_EQ(image.keypoints[i].pixel, other.keypoints[i].pixel);
      EXPECT_EQ(image.keypoints[i].point_id, other.keypoints[i].point_id);
    }
  }
  ASSERT_EQ(a.points.size(), b.points.size());
  for (const auto& [id, point] : a.points) {
    const ColmapPoint& other = b.points.at(id);
    EXPECT_EQ(point.position, other.position);
    EXPECT_EQ(point.color, other.color);
    EXPECT_EQ(point.error_px, other.error_px);
    EXPECT_EQ(point.track, other.track);
  }
}

TEST(ColmapModel, TextAndBinaryAreRead) {
  const TemporaryFolder binary, text;
  write_colmap_model(binary.path(), some_model());
  text.write("cameras.txt",
             "1 OPENCV 960 640 2152.4 2150.1 480 319.75 -0.08 0.03 6e-4 -4e-4\n"
             "7 SIMPLE_RADIAL 720 480 1937.25 362 237.5 -0.01\n");
  std::string images;
  for (const auto& [id, image] : some_model().images) {
    std::ostringstream line;
    line.precision(17);
    line << id;
    for (const double q : quaternion_from_rotation(image.pose.rotation)) line << ' ' << q;
    for (const double t : image.pose.translation) line << ' ' << t;
    line << ' ' << image.camera_id << ' ' << image.name << '\n' << (id == 3 ? "10.75 21.25 5 1.5 2.5 -1\n" : "\n");
    images += line.str();
  }
  text.write("images.txt", images);
  text.write("points3D.txt", "# POINT3D_ID, X, Y, Z, …\n5 0.1 -20.5 30.25 1 2 255 0.75 3 0 4 11\n");
  for (const TemporaryFolder* folder : {&binary, &text}) {
    expect_same(read_colmap_model(folder->path()), some_model());
    const ColmapModel part = read_colmap_model(folder->path(), ColmapParts::cameras_and_images);
    EXPECT_TRUE(part.points.empty());
    EXPECT_TRUE(part.images.at(3).keypoints.empty());
  }
}

TEST(ColmapModel, PixelCentersAreAtHalfInFilesAndAtZeroInMemory) {
  const TemporaryFolder folder;
  folder.write("cameras.txt", "# c\n1 PINHOLE 100 80 500 510 50 40\n2 SIMPLE_RADIAL 100 80 500 50 40 0.1\n");
  folder.write("images.txt", "1 1 0 0 0 0 0 5 1 a.jpg\n50 40 -1 0.5 0.5 9\n2 2 0 0 0 0 0 5 2 b c.jpg\n\n");
  const ColmapModel model = read_colmap_model(folder.path());
  EXPECT_EQ(model.cameras.at(1).params, (std::vector<double>{500, 510, 49.5, 39.5}));
  EXPECT_EQ(model.cameras.at(2).params, (std::vector<double>{500, 49.5, 39.5, 0.1}));
  // The point on the optical axis projects to the principal point, where the keypoint lies.
  const Pinhole camera = model.cameras.at(1).pinhole();
  EXPECT_EQ(camera.project({0, 0, 5}), model.images.at(1).keypoints[0].pixel);
  EXPECT_EQ(model.images.at(1).keypoints[1].pixel, Eigen::Vector2d(0, 0));
  EXPECT_EQ(model.images.at(1).keypoints[0].point_id, ColmapKeypoint::no_point);
  EXPECT_EQ(model.images.at(1).keypoints[1].point_id, 9u);
  EXPECT_EQ(model.images.at(2).name, "b c.jpg");
  EXPECT_EQ(model.images.at(2).pose.rotation, Eigen::Matrix3d::Identity()) << "quaternions are normalized";
}

TEST(ColmapModel, QuaternionIsScalarFirstAndCamFromWorld) {
  const double half = std::sqrt(0.5);
  const Eigen::Matrix3d rotation = rotation_from_quaternion({half, 0, 0, half}, "test");  // 90° about z
  EXPECT_LT((rotation * Eigen::Vector3d::UnitX() - Eigen::Vector3d::UnitY()).norm(), 1e-15);
  const auto back = quaternion_from_rotation(rotation);
  EXPECT_NEAR(back[0], half, 1e-15);
  EXPECT_NEAR(back[3], half, 1e-15);
}

TEST(ColmapModel, ACameraAndAPoseAreReadBackFromText) {
  const TemporaryFolder folder;
  const Pinhole camera{{720, 480}, 1937.25, 1938.5, 361.25, 237.5};
  folder.write("cameras.txt", colmap_text(camera));
  folder.write("images.txt", colmap_text(some_pose(1), "station"));
  EXPECT_NE(read_file(folder / "cameras.txt", "camera").find("1 PINHOLE 720 480 1937.25 1938.5 361.75 238\n"),
            std::string::npos);
  const ColmapModel model = read_colmap_model(folder.path());
  EXPECT_EQ(model.cameras.at(1).pinhole().cx, 361.25);
  EXPECT_LT((model.image("station", "test").pose.rotation - some_pose(1).rotation).norm(), 1e-14);
}

TEST(ColmapModel, ErrorsNameFileLineAndValue) {
  const TemporaryFolder folder;
  const auto rejects = [&](const std::string& cameras, const std::string& images, const auto&... parts) {
    folder.write("cameras.txt", cameras);
    folder.write("images.txt", images);
    expect_error(
        ErrorCode::input, [&] { read_colmap_model(folder.path()); }, parts...);
  };
  const std::string camera = "1 PINHOLE 100 80 500 500 50 40\n", image = "1 1 0 0 0 0 0 5 1 a.jpg\n\n";
  rejects("1 CRYSTAL_BALL 100 80 1 1 1 1 1 1 1 1\n", image, "cameras.txt line 1", "CRYSTAL_BALL", "FULL_OPENCV");
  rejects("1 PINHOLE 100 80 500 500 50\n", image, "line 1", "3 parameters", "expected 4");
  rejects("1 PINHOLE 100 80 500 x 50 40\n", image, "\"x\"", "expected a number");
  rejects("1 PINHOLE 0 80 500 500 50 40\n", image, "image size");
  rejects("1 PINHOLE 4294967397 80 500 500 50 40\n", image, "image size");
  rejects("1 PINHOLE 100 80 500 nan 50 40\n", image, "finite");
  rejects(camera + camera, image, "camera id 1 appears twice");
  rejects(camera, "1 1 0 0 0 0 0 5 2 a.jpg\n\n", "images.txt line 1", "camera id 2");
  rejects(camera, "1 0 0 0 0 0 0 5 1 a.jpg\n\n", "quaternion", "no direction");
  rejects(camera, "1 1 0 0\n\n", "images.txt line 1", "expected a number");
  rejects(camera, image + image, "image id 1 appears twice");
  rejects(camera, "1 1 0 0 0 0 0 5 1 a.jpg\n1 2\n", "images.txt line 2", "point id");
  const TemporaryFolder empty;
  expect_error(
      ErrorCode::input, [&] { read_colmap_model(empty.path()); }, "no cameras and images files");
  expect_error(
      ErrorCode::input, [&] { read_colmap_model(empty / "none"); }, "is not a folder");
  expect_error(
      ErrorCode::input, [&] { some_model().image("x.jpg", "[camera].image"); }, "[camera].image", "x.jpg",
      "view 00.jpg");
  ColmapModel brown;
  brown.cameras[1] = {LensModel::brown, {100, 80}, {50, 0.1, 0, 0, 0, 0, 0, 0, 0, 0}};
  expect_error(
      ErrorCode::input, [&] { write_colmap_model(empty.path(), brown); }, "BROWN");
}

TEST(ColmapModel, ImagesOfFisheyeCamerasAreLeftOut) {
  const TemporaryFolder text, binary;
  text.write("cameras.txt", "1 OPENCV_FISHEYE 100 80 500 500 50 40 0 0 0 0\n2 PINHOLE 100 80 500 510 50 40\n");
  text.write("images.txt", "1 1 0 0 0 0 0 5 1 a.jpg\n\n2 1 0 0 0 0 0 5 2 b.jpg\n\n");
  ColmapModel model = some_model();
  write_colmap_model(binary.path(), model);
  std::string cameras = read_file(binary / "cameras.bin", "model");
  cameras[12] = 5;  // the first camera's model is OPENCV, with as many parameters
  binary.write("cameras.bin", cameras);
  const auto rejects = [](const ColmapModel& read, const std::string& name) {
    expect_error(
        ErrorCode::input, [&] { read.image(name, "[camera].image"); }, "[camera].image = \"" + name + "\"",
        "OPENCV_FISHEYE", "image_undistorter");
  };
  const ColmapModel of_text = read_colmap_model(text.path()), of_binary = read_colmap_model(binary.path());
  EXPECT_EQ(of_text.cameras.at(of_text.image("b.jpg", "test").camera_id).pinhole().fy, 510);
  rejects(of_text, "a.jpg");
  EXPECT_EQ(of_binary.image("sub/station.jpg", "test").camera_id, 7U);
  rejects(of_binary, "view 00.jpg");
}

TEST(ColmapModel, ImagesOfCamerasThatColmapHadLaterAreLeftOut) {
  const TemporaryFolder text, binary;
  text.write("cameras.txt", "1 EQUIRECTANGULAR 9 8 9 8\n2 EUCM 9 8 5 5 4 4 0.5 1\n3 PINHOLE 9 8 5 5 4 4\n");
  text.write("images.txt", "1 1 0 0 0 0 0 5 1 a.jpg\n\n2 1 0 0 0 0 0 5 2 b.jpg\n\n3 1 0 0 0 0 0 5 3 c.jpg\n\n");
  write_colmap_model(binary.path(), some_model());
  std::string cameras = read_file(binary / "cameras.bin", "model");
  cameras[100] = 12;  // the second camera's model is SIMPLE_DIVISION, with as many parameters
  binary.write("cameras.bin", cameras);
  const ColmapModel of_text = read_colmap_model(text.path()), of_binary = read_colmap_model(binary.path());
  EXPECT_EQ(of_text.image("c.jpg", "test").camera_id, 3U);
  EXPECT_EQ(of_binary.image("view 00.jpg", "test").camera_id, 1U);
  const auto rejects = [](const ColmapModel& read, const std::string& name, const std::string& camera) {
    expect_error(
        ErrorCode::input, [&] { read.image(name, "test"); }, camera, "image_undistorter");
  };
  rejects(of_text, "a.jpg", "EQUIRECTANGULAR");
  rejects(of_text, "b.jpg", "EUCM");
  rejects(of_binary, "sub/station.jpg", "SIMPLE_DIVISION");
}

TEST(ColmapModel, TruncatedAndDamagedBinariesAreInputErrors) {
  const TemporaryFolder folder;
  write_colmap_model(folder.path(), some_model());
  std::mt19937 random(5);
  for (const std::string name : {"cameras.bin", "images.bin", "points3D.bin"}) {
    const std::string bytes = read_file(folder / name, "model");
    for (std::size_t length = 0; length < bytes.size(); ++length) {
      folder.write(name, bytes.substr(0, length));
      expect_error(
          ErrorCode::input, [&] { read_colmap_model(folder.path()); }, name.substr(0, 6));
    }
    for (int round = 0; round < 300; ++round) {
      std::string damaged = bytes;
      damaged[random() % damaged.size()] = static_cast<char>(random());
      folder.write(name, damaged);
      try {
        read_colmap_model(folder.path());
      } catch (const Error& error) {
        EXPECT_EQ(error.code(), ErrorCode::input);
      }
    }
    std::string claims = bytes;
    const std::uint64_t many = 4'000'000'000;
    std::memcpy(claims.data(), &many, 8);
    folder.write(name, claims);
    expect_error(
        ErrorCode::input, [&] { read_colmap_model(folder.path()); }, name, "claims 4000000000");
    folder.write(name, bytes);
  }
}

TEST(ColmapArray, ReadsChannelPlanarMaps) {
  const TemporaryFolder folder;
  const auto write = [&](const std::string& header, const std::vector<float>& values) {
    std::string bytes = header;
    bytes.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(float));
    return folder.write("a.geometric.bin", bytes);
  };
  const Image<float> depth = read_colmap_array(write("3&2&1&", {1, 2, 3, 0, 5, 6}));
  EXPECT_EQ(depth.size(), (Size{3, 2}));
  EXPECT_EQ(depth(2, 0), 3);
  EXPECT_TRUE(std::isnan(depth(0, 1)));
  const Image<float> normals = read_colmap_array(write("2&1&3&", {1, 0, 2, 0, 3, 0}));
  EXPECT_EQ(normals(0, 0, 0), 1);
  EXPECT_EQ(normals(0, 0, 1), 2);
  EXPECT_EQ(normals(0, 0, 2), 3);
  EXPECT_TRUE(std::isnan(normals(1, 0, 2)));
  expect_error(
      ErrorCode::input,
      [&] {
        read_colmap_array(write("3&2&1&", {1, 2}));
      },
      "8 bytes", "expected 24");
  expect_error(
      ErrorCode::input,
      [&] {
        read_colmap_array(write("60000&60000&3&", {1, 2}));
      },
      "bytes of pixels");
  expect_error(
      ErrorCode::input, [&] { read_colmap_array(write("hello", {})); }, "no header");
  expect_error(
      ErrorCode::input, [&] { read_colmap_array(write("3&2", {})); }, "truncated");
}

TEST(ColmapModel, RenderedStationsLoad) {
  const std::filesystem::path data = shared_data() / "rendered";
  if (!std::filesystem::exists(data)) GTEST_SKIP() << data << " is absent";
  const ColmapModel model = read_colmap_model(data / "relief/gt_sparse_distorted");
  const ColmapImage& station = model.image("station.jpg", "test");
  EXPECT_EQ(model.cameras.at(station.camera_id).size, (Size{720, 480}));
  EXPECT_TRUE(model.cameras.at(station.camera_id).has_distortion());
}

}  // namespace
}  // namespace malus
