#include "malus/station/check.h"

#include <gtest/gtest.h>

#include "io/temporary_folder.h"
#include "malus/io/image_file_internal.h"
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
        ErrorCode::input, [&] { expected_times(scaled_station(), Options(), {}, {}, context); }, said);
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

TEST(CheckStation, MeasuresThePriorScaledToKnownDistances) {
  Station station = scaled_station();
  station.prior = cloud_of(station);
  const Plan plan = check_station(station, {}, {});
  std::string does;
  for (const std::string& line : plan.does) does += line + "\n";
  expect_contains(does, "known distances make the prior 2 times as large; they are then off by 0.001 mm");
  expect_contains(does, "200 mm from the camera");
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
      ErrorCode::input, [&] { check_station(station, {}, {}); }, "label image has the value 255");

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
  const auto of_prior = [&] { return expected_times(station, {}, "prior", {}, {}).back().seconds; };
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
