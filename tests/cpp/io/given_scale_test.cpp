#include <gtest/gtest.h>

#include "malus/core/error.h"
#include "malus/io/given_scale_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

/// Two cameras side by side that look along z, and the marks of a point in their images.
struct Pair {
  ColmapModel model;

  Pair() {
    model.cameras[1] = {LensModel::pinhole, {200, 200}, {100, 100, 99.5, 99.5}};
    for (const std::uint32_t id : {1U, 2U}) {
      ColmapImage image;
      image.name = id == 1 ? "left.jpg" : "right.jpg";
      image.camera_id = 1;
      image.pose.translation = {id == 1 ? 0.5 : -0.5, 0, 0};
      model.images[id] = image;
    }
  }
  std::vector<ImageMark> marks(const Eigen::Vector3d& point) const {
    std::vector<ImageMark> result;
    for (const auto& [id, image] : model.images) {
      const Eigen::Vector2d pixel = model.cameras.at(1).project(image.pose.cam_from_world(point));
      result.push_back({image.name, pixel.x(), pixel.y()});
    }
    return result;
  }
  ScaleBar bar(const Eigen::Vector3d& a, const Eigen::Vector3d& b, double distance) const {
    ScaleBar bar;
    bar.distance = distance;
    bar.a = marks(a);
    bar.b = marks(b);
    return bar;
  }
};

TEST(GivenScale, FromMarksInTheImagesOfTheModel) {
  const Pair pair;
  const GivenScale scale = given_scale({pair.bar({-1, 0, 5}, {1, 0, 5}, 250)}, &pair.model, "s.toml: [[scale]]");
  EXPECT_NEAR(scale.factor, 125, 1e-6);
  EXPECT_NEAR(scale.errors.at(0), 0, 1e-6);
}

TEST(GivenScale, FromPointsOfTheCloud) {
  ScaleBar bar;
  bar.distance = 10;
  bar.a_xyz = {1, 1, 1};
  bar.b_xyz = {1, 4, 5};
  EXPECT_DOUBLE_EQ(given_scale({bar}, nullptr, "s").factor, 2);
}

TEST(GivenScale, LeastSquaresOverBarsAndOneHeldOut) {
  const auto bar = [](double distance, double length, bool check) {
    ScaleBar result;
    result.distance = distance;
    result.a_xyz = {0, 0, 0};
    result.b_xyz = {length, 0, 0};
    result.check = check;
    return result;
  };
  const GivenScale scale = given_scale({bar(2, 1, false), bar(6.6, 3, false), bar(9, 4, true)}, nullptr, "s");
  EXPECT_NEAR(scale.factor, (2 * 1 + 6.6 * 3) / 10.0, 1e-12);
  EXPECT_NEAR(scale.errors.at(2), 4 * scale.factor - 9, 1e-12);
  EXPECT_THROW(given_scale({bar(9, 4, true)}, nullptr, "s"), Error);
  EXPECT_THROW(given_scale({bar(9, 0, false)}, nullptr, "s"), Error);
}

TEST(GivenScale, WrongMarksAreNamed) {
  const Pair pair;
  ScaleBar parallel = pair.bar({0, 0, 5}, {1, 0, 5}, 1);
  parallel.a[1] = parallel.a[0];
  ScaleBar unknown = pair.bar({0, 0, 5}, {1, 0, 5}, 1);
  unknown.b[0].image = "other.jpg";
  EXPECT_THROW(given_scale({parallel}, &pair.model, "s"), Error);
  EXPECT_THROW(given_scale({unknown}, &pair.model, "s"), Error);
  EXPECT_THROW(given_scale({unknown}, nullptr, "s"), Error);
  ScaleBar outside = pair.bar({0, 0, 5}, {1, 0, 5}, 1);
  outside.b[1].x = 250;
  EXPECT_THROW(given_scale({outside}, &pair.model, "s"), Error);
}

TEST(GivenScale, RaysThatMeetBehindACameraAreRefused) {
  const Pair pair;
  // Marks of a point behind the cameras are where its mirror image would be: their rays diverge in front of them.
  const ScaleBar exchanged = pair.bar({0, 0, -5}, {1, 0, 5}, 1);
  expect_error(
      ErrorCode::input, [&] { given_scale({exchanged}, &pair.model, "s"); }, "meet behind left.jpg", "same point");
}

TEST(GivenScale, MarksWhereTheLensBendsBackAreRefused) {
  Pair pair;
  pair.model.cameras[1] = {LensModel::simple_radial, {200, 200}, {100, 99.5, 99.5, -0.3}};
  ScaleBar corner = pair.bar({0, 0, 5}, {1, 0, 5}, 1);
  EXPECT_NO_THROW(given_scale({corner}, &pair.model, "s"));
  corner.a[0].x = corner.a[0].y = 0;
  expect_error(
      ErrorCode::input, [&] { given_scale({corner}, &pair.model, "s"); }, "left.jpg", "sends no ray");
}

}  // namespace
}  // namespace malus
