#include "malus/station/check.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <limits>
#include <string>
#include <utility>

#include "io/temporary_folder.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/ply_writer_internal.h"
#include "malus/station/check_picture_internal.h"
#include "malus/station/prior_scale_internal.h"
#include "malus/station/reconstruct.h"
#include "thrown_error.h"

namespace malus {
namespace {

/// A station that looks along z. Known distances scale its prior by 2.
Station scaled_station() {
  Station station;
  constexpr Size size{40, 30};
  station.images = {Image<float>(size, 1, 0.5F)};
  station.file.polarized.angles_deg = {0};
  station.file.camera = CameraSpec{{LensModel::pinhole, size, {200, 200, 19.5, 14.5}}, {}};
  station.file.prior_scale = 2;
  station.file.scale_bars.emplace_back().distance = 10;
  station.file.scale_errors = {0.001};
  return station;
}

/// A cloud that fills the view at depth 100.
PointCloud cloud_of(const Station& station) {
  PointCloud cloud;
  const Pinhole pinhole = station.file.camera->lens.pinhole();
  for (int v = 0; v < pinhole.size.height; ++v)
    for (int u = 0; u < pinhole.size.width; ++u) cloud.points.push_back(100 * pinhole.ray(u, v));
  return cloud;
}

std::string plan_of(const Station& station, const Options& options = {}) {
  std::string does;
  for (const std::string& line : check_station(station, options, {}).does) does += line + "\n";
  return does;
}

/// Ceres refuses such a number, and a reflection fit by which nothing was fitted passed for one.
TEST(Threads, FewerThanOneAreRefused) {
  Context context;
  for (const int threads : {0, -1}) {
    context.threads = threads;
    const std::string said = "threads = " + std::to_string(threads) + ", expected at least 1";
    expect_error(
        ErrorCode::input, [&] { reconstruct(scaled_station(), Options(), RunOptions(), context); }, said);
    expect_error(
        ErrorCode::input, [&] { check_station(scaled_station(), Options(), context); }, said);
    expect_error(
        ErrorCode::input, [&] { expected_times(scaled_station(), Options(), {}, context); }, said);
  }
}

/// A program that embeds the library can make such stations; files and Python's arrays are checked before.
TEST(CheckStation, RefusesStationsInMemoryThatLackImagesOrHaveAnotherMask) {
  Station station = scaled_station();
  station.mask = Mask({7, 30}, 1, 255);
  expect_error(
      ErrorCode::input, [&] { check_station(station, Options(), Context()); }, "mask is 7 x 30", "40 x 30");
  station.images.clear();
  expect_error(
      ErrorCode::input, [&] { check_station(station, Options(), Context()); }, "no polarized images");
  station = scaled_station();
  station.file.camera->lens.params.pop_back();
  expect_error(
      ErrorCode::input, [&] { check_station(station, Options(), Context()); }, "[camera]: 3 parameters");
}

TEST(CheckStation, ReadsImagesInMemoryAsItReadsFiles) {
  Station station = scaled_station();
  station.prior = Shape(PlaneShape{{0, 0, 100}, {0, 0, -1}});
  station.file.prior_sigma = 1;
  EXPECT_TRUE(check_station(station, {}, {}).warnings.empty());
  std::fill_n(station.images[0].row(0), 120, 1.0F);
  const Plan clipped = check_station(station, {}, {});
  ASSERT_EQ(clipped.warnings.size(), 1U);
  expect_contains(clipped.warnings[0], "images[0]: 10 % of the object's pixels are saturated");
  station.images[0](3, 4) = std::numeric_limits<float>::quiet_NaN();
  expect_error(
      ErrorCode::input, [&] { check_station(station, {}, {}); }, "images[0]");
}

TEST(CheckStation, ReadsLabelsInMemory) {
  Station station = scaled_station();
  station.prior = TriangleMesh{cloud_of(station), {{0, 39, 1199}, {0, 1199, 1160}}};
  station.labels = Mask({40, 30}, 1, std::uint8_t{2});
  station.file.optics.reflection = ReflectionChoice::labels;
  const Plan plan = check_station(station, {}, {});
  const std::string expected = "prior: mesh of 2 triangles, covers 97 % of the object";
  EXPECT_NE(std::ranges::find(plan.does, expected), plan.does.end());
  (*station.labels)(3, 4) = 7;
  expect_error(
      ErrorCode::input, [&] { check_station(station, {}, {}); }, "label image has the value 7");
}

TEST(CheckStation, RefusesAPriorWithoutAPoseBeforeAnythingIsComputed) {
  Station station = scaled_station();
  station.prior = cloud_of(station);
  station.file.camera.reset();
  expect_error(
      ErrorCode::input, [&] { check_station(station, Options(), Context()); }, "[camera] has no pose");
  // The polarization would be the first step, and would refuse the single image.
  expect_error(
      ErrorCode::input, [&] { reconstruct(station, Options(), RunOptions(), Context()); }, "[camera] has no pose");
}

TEST(CheckPicture, ShowsThePriorScaledToKnownDistances) {
  Station station = scaled_station();
  const std::vector<PriorSource> sources{cloud_of(station), Image<float>({40, 30}, 1, 100.0F),
                                         Shape(PlaneShape{{0, 0, 100}, {0, 0, -1}})};
  for (const PriorSource& source : sources) {
    station.prior = source;
    const std::vector<Eigen::Vector3f> points = check_picture(station, {}).points;
    ASSERT_EQ(points.size(), 1200U) << source.index();
    for (const Eigen::Vector3f& point : points) ASSERT_NEAR(point.z(), 200, 1e-3) << source.index();
  }
}

TEST(CheckPicture, LeavesOutPointsThatTheLensDoesNotSee) {
  Station station = scaled_station();
  station.file.prior_scale = 1;
  station.file.camera->lens = {LensModel::opencv, {40, 30}, {30, 30, 19.5, 14.5, -0.25, 0, 0, 0}};
  // The polynomial sends a direction of twice the focal length to the principal point.
  PointCloud cloud;
  cloud.points = {{0, 0, 100}, {20, 10, 100}, {200, 0, 100}};
  station.prior = cloud;
  const std::vector<Eigen::Vector3f> points = check_picture(station, {}).points;
  ASSERT_EQ(points.size(), 2U);
  EXPECT_NEAR(points[1].x(), 25.425, 1e-3);
}

TEST(CheckPicture, CanBeCanceledWhilePointsAreProjected) {
  Station station = scaled_station();
  station.prior = cloud_of(station);
  const std::atomic<bool> cancel{true};
  Context context;
  context.cancel = &cancel;
  expect_error(ErrorCode::interrupted, [&] { check_picture(station, context); });
}

TEST(CheckPicture, ThinsPointsOutEvenly) {
  Station station = scaled_station();
  station.file.prior_scale = 1;
  const PointCloud view = cloud_of(station);
  PointCloud cloud;
  for (int round = 0; round < 250; ++round)
    cloud.points.insert(cloud.points.end(), view.points.begin(), view.points.end());
  station.prior = cloud;
  // Every fourth of 300 000.
  EXPECT_EQ(check_picture(station, {}).points.size(), 75000U);
}

TEST(CheckStation, MeasuresThePriorScaledToKnownDistances) {
  Station station = scaled_station();
  station.prior = cloud_of(station);
  const std::string does = plan_of(station);
  expect_contains(does, "known distances make the prior 2 times as large; they are then off by 0.001 mm");
  expect_contains(does, "200 mm from the camera");
}

TEST(CheckStation, LimitsTheConfidenceForCautionsAsARunWould) {
  Station station = scaled_station();
  // Part of the image of a lens so long that depths in single precision are coarse.
  station.file.camera->lens.params = {1e6, 1e6, 5000, 14.5};
  station.file.prior_scale = 1900;
  station.prior = cloud_of(station);
  const Plan plan = check_station(station, {}, {});
  EXPECT_EQ(plan.confidence.level, ConfidenceLevel::partial);
  ASSERT_EQ(plan.confidence.reasons.size(), 1U);
  expect_contains(plan.confidence.reasons[0], "rounded so much in single precision");
}

/// Only the check before a run named the unit.
TEST(PriorOfStation, SaysWhyItMissesTheObject) {
  Station station = scaled_station();
  station.file.prior_scale = 1;
  station.file.camera->pose.translation = {0, 0, 100};
  station.images.assign(4, Image<float>({40, 30}, 1, 0.5F));
  station.file.polarized.angles_deg = {0, 45, 90, 135};
  PointCloud in_meters = cloud_of(station);
  for (Eigen::Vector3d& point : in_meters.points) point = 1e-3 * station.file.camera->pose.world_from_cam(point);
  const TriangleMesh mesh{in_meters, {{0, 39, 1199}, {0, 1199, 1160}}};
  for (const PriorSource& source : {PriorSource(in_meters), PriorSource(mesh)}) {
    station.prior = source;
    expect_error(
        ErrorCode::data, [&] { reconstruct(station, Options(), {.until = "prior"}, Context()); },
        "in m and the camera in mm (a factor of 1000): only then does it fall there");
  }
}

TEST(CheckStation, SaysThatTheObjectIsTreatedAsAStatedMetal) {
  Station station = scaled_station();
  station.prior = cloud_of(station);
  EXPECT_EQ(plan_of(station).find("metal"), std::string::npos);
  station.file.optics.metal = "bronze";
  expect_contains(plan_of(station), "fuse: the surface of bare metal, as optics.metal = \"bronze\" states");
  expect_contains(plan_of(station), "0.519+2.415i");
  Options grid;
  grid.fusion = Fusion::grid;
  expect_contains(plan_of(station, grid),
                  "the surface of a dielectric: optics.metal = \"bronze\" changes the refinement");
}

/// Two triangles at this z that fill the view.
TriangleMesh mesh_at(double z) {
  TriangleMesh mesh;
  mesh.vertices.points = {{-50, -50, z}, {50, -50, z}, {50, 50, z}, {-50, 50, z}};
  mesh.triangles.push_back({0, 1, 2});
  mesh.triangles.push_back({0, 2, 3});
  return mesh;
}

/// A mesh, a depth map or a shape beside the object passed, and ended the run only after the images were read.
TEST(CheckStation, SaysWhatEveryKindOfPriorCovers) {
  const TemporaryFolder folder;
  Station station = scaled_station();
  station.file.prior_sigma = 1;
  const auto mesh_file = [&](const char* name, double z) {
    write_ply(folder / name, mesh_at(z));
    return MeshFile{folder / name};
  };
  Image<float> left({40, 30}, 1, std::numeric_limits<float>::quiet_NaN());
  for (int v = 0; v < 30; ++v) std::fill_n(left.row(v), 20, 100.0F);
  const std::vector<std::pair<PriorSource, std::string>> seen{
      {mesh_file("mesh.ply", 100), "mesh of 2 triangles, covers 100 % of the object"},
      {left, "depth map, covers 50 % of the object"},
      {Shape(PlaneShape{{0, 0, 100}, {0, 0, -1}}), "plane, covers 100 %"},
      {Shape(SphereShape{{0, 0, 200}, 100}), "sphere, covers 100 %"},
      {Shape(CylinderShape{{0, 0, 200}, {0, 1, 0}, 100}), "cylinder, covers 100 %"}};
  for (const auto& [source, words] : seen) {
    station.prior = source;
    const std::string does = plan_of(station);
    expect_contains(does, "prior: " + words);
    expect_contains(does, "evidence: the object is ");
  }
  const std::vector<PriorSource> beside{
      mesh_file("behind.ply", -100), Image<float>({40, 30}, 1, 0.0F), Shape(PlaneShape{{0, 0, -100}, {0, 0, -1}}),
      Shape(SphereShape{{500, 0, 200}, 10}), Shape(CylinderShape{{500, 0, 200}, {0, 1, 0}, 10})};
  for (const PriorSource& source : beside) {
    station.prior = source;
    expect_error(
        ErrorCode::data, [&] { plan_of(station); }, "0 object pixels have a depth, expected at least 30");
  }
}

/// The number was counted as a depth: the map covered all of the object, which was 200 m wide.
TEST(CheckStation, TakesALargeNumberForNoDepthAsARunWould) {
  Station station = scaled_station();
  Image<float> depth({40, 30}, 1, 1e6F);
  for (int v = 0; v < 30; ++v) std::fill_n(depth.row(v), 20, 100.0F);
  station.prior = depth;
  const Plan plan = check_station(station, {}, {});
  ASSERT_EQ(plan.warnings.size(), 1U);
  expect_contains(plan.warnings[0], "taken as pixels without a depth");
  const std::string expected = "prior: depth map, covers 50 % of the object";
  EXPECT_NE(std::ranges::find(plan.does, expected), plan.does.end());
}

TEST(CheckStation, AsksForTheSigmaOfAShapeAsARunWould) {
  Station station = scaled_station();
  station.prior = Shape(PlaneShape{{0, 0, 100}, {0, 0, -1}});
  expect_error(
      ErrorCode::input, [&] { plan_of(station); }, "prior plane: sigma is missing");
  station.file.prior_sigma = 0.5;
  expect_contains(plan_of(station), "prior: plane, covers 100 %");
}

TEST(CheckStation, SaysThatADeviationOfMoreThanTenPixelsLimitsTheConfidence) {
  Station station = scaled_station();
  station.prior = Shape(PlaneShape{{0, 0, 100}, {0, 0, -1}});
  const double gsd = station.file.prior_scale * 100 / station.file.camera->lens.pinhole().focal();
  station.file.prior_sigma = 9 * gsd;
  EXPECT_TRUE(check_station(station, {}, {}).confidence.reasons.empty());
  station.file.prior_sigma = 14 * gsd;
  const Plan plan = check_station(station, {}, {});
  EXPECT_EQ(plan.confidence.level, ConfidenceLevel::low);
  ASSERT_EQ(plan.warnings.size(), 1U);
  expect_contains(plan.warnings[0], "14 times the ground sampling distance");
}

TEST(KnownDistances, ScaleTheLengthsOfShapesAndNotTheirDirections) {
  const auto plane = std::get<PlaneShape>(scaled(Shape(PlaneShape{{1, 2, 3}, {0, 0, -2}}), 2));
  EXPECT_EQ(plane.point, Eigen::Vector3d(2, 4, 6));
  EXPECT_EQ(plane.normal, Eigen::Vector3d(0, 0, -2));
  const auto sphere = std::get<SphereShape>(scaled(Shape(SphereShape{{1, 2, 3}, 4}), 2));
  EXPECT_EQ(sphere.center, Eigen::Vector3d(2, 4, 6));
  EXPECT_EQ(sphere.radius, 8);
  const auto cylinder = std::get<CylinderShape>(scaled(Shape(CylinderShape{{1, 2, 3}, {0, 3, 0}, 4}), 2));
  EXPECT_EQ(cylinder.point, Eigen::Vector3d(2, 4, 6));
  EXPECT_EQ(cylinder.axis, Eigen::Vector3d(0, 3, 0));
  EXPECT_EQ(cylinder.radius, 8);
}

TEST(CheckStation, ReadsADepthMapAndLabelsAsARunWould) {
  const TemporaryFolder folder;
  Station station = scaled_station();
  write_float_tiff(folder / "small.tif", Image<float>({20, 30}, 1, 100.0F));
  write_float_tiff(folder / "depth.tif", Image<float>({40, 30}, 1, 100.0F));
  write_png(folder / "labels.png", Image<std::uint8_t>({40, 30}, 1, std::uint8_t{255}));
  station.prior = DepthFile{folder / "missing.tif"};
  expect_error(
      ErrorCode::input, [&] { check_station(station, {}, {}); }, "missing.tif");
  station.prior = DepthFile{folder / "small.tif"};
  expect_error(
      ErrorCode::input, [&] { check_station(station, {}, {}); }, "prior depth map");
  station.prior = DepthFile{folder / "depth.tif"};
  check_station(station, {}, {});
  station.file.optics.label_image = folder / "labels.png";
  expect_error(
      ErrorCode::input, [&] { check_station(station, {}, {}); },
      "label image " + (folder / "labels.png").string() + " has the value 255");
  write_png(folder / "labels.png", Image<std::uint8_t>({30, 40}, 1, std::uint8_t{1}));
  expect_error(
      ErrorCode::input, [&] { check_station(station, {}, {}); },
      "label image " + (folder / "labels.png").string() + " is 30 x 40 pixels, expected 40 x 30");

  std::filesystem::create_directory(folder / "polarization");
  station.file.optics.label_image = folder / "polarization/label.png";
  write_png(*station.file.optics.label_image, Image<std::uint8_t>({40, 30}, 1, std::uint8_t{1}));
  folder.write("manifest.json", "{}");
  check_station(station, {}, {});
  station.file.camera->lens = {LensModel::opencv, {40, 30}, {200, 200, 19.5, 14.5, -0.25, 0, 0, 0}};
  expect_error(
      ErrorCode::input, [&] { check_station(station, {}, {}); }, "label.png is of a run", "images as taken");
}

TEST(CheckStation, CountsSaturatedPixelsAsARunWould) {
  const TemporaryFolder folder;
  Station station = scaled_station();
  station.prior = Shape(PlaneShape{{0, 0, 100}, {0, 0, -1}});
  station.file.prior_sigma = 1;
  station.images.clear();
  const auto warnings = [&](const char* name) {
    station.file.polarized.images = {folder / name};
    std::string all;
    for (const std::string& warning : check_station(station, {}, {}).warnings) all += warning + "\n";
    return all;
  };
  Image<std::uint16_t> numbers({40, 30}, 1, std::uint16_t{3000});
  std::fill_n(numbers.row(0), 120, std::uint16_t{4095});
  write_png16(folder / "12.png", numbers);
  expect_contains(warnings("12.png"), "is white_level = 4095 right?");
  station.file.polarized.white_level = 4095;
  expect_contains(warnings("12.png"), "10 % of the object's pixels are saturated");

  station.file.polarized.white_level.reset();
  Image<std::uint8_t> reddish({40, 30}, 3, std::uint8_t{120});
  for (std::size_t i = 0; i < reddish.count(); i += 3) reddish[i] = 255;
  write_png(folder / "red.png", reddish);
  expect_contains(warnings("red.png"), "100 % of the object's pixels are saturated");
  station.file.polarized.channel = ColorChannel::green;
  EXPECT_EQ(warnings("red.png").find("saturated"), std::string::npos) << "red is not used";
}

TEST(CheckStation, DoesNotDoubtTheWhiteLevelOfWholeNumbersInMemory) {
  Station station = scaled_station();
  Image<float> numbers({40, 30}, 1, 3000.0F);
  std::fill_n(numbers.row(0), 120, 4095.0F);
  station.images.assign(4, numbers);
  station.file.polarized.angles_deg = {0, 45, 90, 135};
  station.whole_numbers = true;
  station.file.polarized.white_level = 4095;
  std::string all;
  Context context;
  context.on_log = [&](LogLevel, const std::string& text) { all += text + "\n"; };
  const Results results = reconstruct(station, Options(), {.until = "polarization"}, context);
  EXPECT_EQ(results.get<MeasuredPolarization>()->state->valid(0, 0), static_cast<int>(PixelState::saturated));
  EXPECT_EQ(all.find("white_level"), std::string::npos) << all;
}

TEST(CheckStation, ExpectsAPriorFromPhotosToTakeLongerThanACloud) {
  Station station = scaled_station();
  const auto of_prior = [&] { return expected_times(station, {}, {.until = "prior"}, {}).back().seconds; };
  station.prior = cloud_of(station);
  const double of_cloud = of_prior();
  station.prior = {};
  station.file.photos.emplace();
  EXPECT_GT(of_prior(), of_cloud) << "points from photos scatter little, so that smoothing takes finer cells";
}

TEST(CheckStation, KnownDistancesOfAGivenPriorAreFigures) {
  Station station = scaled_station();
  station.file.scale_bars.emplace_back().distance = 20;
  station.file.scale_bars.back().check = true;
  station.file.scale_errors.push_back(-0.5);
  const Json scale = scale_json(station.file);
  EXPECT_EQ(scale.at("scale").get<double>(), 2);
  const Json &used = scale.at("distances").at(0), &held_out = scale.at("distances").at(1);
  EXPECT_FALSE(used.at("check").get<bool>());
  EXPECT_EQ(used.at("adjusted").get<double>(), 10 + 0.001);
  EXPECT_TRUE(held_out.at("check").get<bool>());
  EXPECT_EQ(held_out.at("residual").get<double>(), -0.5);
  station.file.scale_errors.clear();
  EXPECT_TRUE(scale_json(station.file).is_null());
}

TEST(CheckStation, ADistanceMetUpToRoundingIsOffByZero) {
  Station station = scaled_station();
  station.prior = cloud_of(station);
  station.file.scale_errors = {3.6e-15};  // a rounding error
  std::string does;
  for (const std::string& line : check_station(station, {}, {}).does) does += line + "\n";
  expect_contains(does, "they are then off by 0 mm");
  station.file.scale_errors = {0.000012};
  expect_contains(describe_scale(station.file), "off by 0.000012");  // not 1.2e-05
}

}  // namespace
}  // namespace malus
