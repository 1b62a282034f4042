#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "malus/core/degrees_internal.h"
#include "malus/stereo/view_choice_internal.h"
#include "malus/stereo/view_projection_internal.h"
#include "sweep_scenes.h"

namespace malus {
namespace {

using namespace sweep_scenes;

/// The station's view at full and at half size, and the depth of the scene's plane.
struct Levels {
  explicit Levels(const Scene& scene) {
    full.mask = scene.input.mask;
    full.camera = scene.input.camera;
    half = full;
    half.mask = Mask({80, 60}, 1, 255);
    half.reduction = 2;
    log_depth = Image<float>(half.mask.size(), 1, static_cast<float>(std::log(distance_mm)));
  }
  MatchLevel full, half;
  Image<float> log_depth;
};

TEST(ViewProjection, LeavesOutWhereALensBendsBack) {
  // To the corners of the photo the lens sends no ray; its polynomial sends points far outside of the view to its
  // middle.
  const LensCamera bent{LensModel::simple_radial, {4000, 3000}, {1000, 2000, 1500, -0.3}};
  const ViewProjection view({{400, 300}, 1000, 1000, 200, 150}, Pose{}, bent, Pose{});
  EXPECT_LT(view.fit_error_px(), 1e-3);
  EXPECT_NEAR((view.project(300, 200, 2) - bent.distort({0.1, 0.05})).norm(), 0, 1e-3);
  EXPECT_LT(view.project(200 + 1800, 150, 2).x(), -1000);
}

TEST(ViewChoice, WarnsOnceOfALensThatAllPhotosShare) {
  Scene scene = make_scene(plane, 4);
  for (std::size_t k = 1; k < scene.views.size(); ++k) {
    const Pinhole lens = scene.views[k].camera.pinhole();
    scene.views[k].camera = {
        LensModel::full_opencv, lens.size, {lens.fx, lens.fy, lens.cx, lens.cy, 30, 0, 0, 0, 0, 31, 300, 0}};
  }
  std::vector<std::string> told;
  Context context;
  context.on_log = [&](LogLevel, const std::string& message) { told.push_back(message); };
  const ViewChoice photos(scene.input, scene.views, test_options(), context);
  ASSERT_EQ(told.size(), 1U);
  EXPECT_NE(told[0].find("sweep: views[1] and 2 more: the lens is approximated to "), std::string::npos) << told[0];
}

TEST(ViewChoice, HoldsOneLevelOfEachPhotoAndFreesFloatsAtFullSize) {
  Scene scene = make_scene(plane, 4);
  const Image<float> before = scene.views[0].intensity;
  Levels levels(scene);
  ViewChoice photos(scene.input, scene.views, test_options(), {});
  photos.choose(levels.half, levels.log_depth);
  photos.prepare(levels.half, {});
  ASSERT_EQ(levels.half.views.size(), 4U);
  EXPECT_EQ(levels.half.views[0].photo->size(), (Size{95, 70}));
  EXPECT_EQ(levels.half.views[0].scale, 0.5F);
  EXPECT_EQ(scene.views[0].intensity, before);

  photos.prepare(levels.full, {});
  EXPECT_EQ(levels.full.views[0].photo->size(), before.size());
  // The half level now refers to the cells of the full level.
  EXPECT_EQ(levels.half.views[0].photo, levels.full.views[0].photo);
  for (const SweepView& view : scene.views) EXPECT_TRUE(view.intensity.empty());
}

TEST(ViewChoice, CanHalveAPhotoThatItHoldsAsCells) {
  Scene scene = make_scene(plane, 4);
  Levels levels(scene);
  ViewChoice photos(scene.input, scene.views, test_options(), {});
  photos.choose(levels.half, levels.log_depth);
  const Image<float> half = photos.halved_photo(2, {});
  photos.prepare(levels.full, {});
  const Image<float> again = photos.halved_photo(2, {});
  ASSERT_EQ(again.size(), half.size());
  for (std::size_t i = 0; i < half.count(); ++i) EXPECT_NEAR(again[i], half[i], 1e-5F);

  photos.prepare(levels.half, {});
  EXPECT_EQ(levels.half.views[2].photo->size(), half.size());
}

TEST(ViewChoice, ReportsTheParallaxOfTheChosenPhotos) {
  Scene scene = make_scene(plane, 4);
  Levels levels(scene);
  ViewChoice photos(scene.input, scene.views, test_options(), {});
  photos.choose(levels.half, levels.log_depth);
  // Parallax per unit of ln z: base / distance · focal length, in px.
  const double expected = 125 / distance_mm * focal;
  EXPECT_NEAR(photos.parallax(levels.full) / expected, 1, 0.15);
  EXPECT_DOUBLE_EQ(photos.parallax(levels.half), photos.parallax(levels.full) / 2);
}

TEST(ViewChoice, KeepsPhotosFromOnePlaceInOneHalf) {
  Scene scene = make_scene(plane, 4);
  // A second photo from each place, 1.5° aside as from the hand.
  for (std::size_t k = 0; k < 4; ++k) {
    const Eigen::Vector3d toward(0, 0, distance_mm), from = scene.views[k].pose.center() - toward;
    const Eigen::AngleAxisd aside(to_radians(1.5), from.unitOrthogonal());
    scene.views.push_back(photo(plane, toward + aside * from, distorted_lens()));
  }
  Levels levels(scene);
  ViewChoice photos(scene.input, scene.views, test_options(), {});
  photos.choose(levels.half, levels.log_depth);
  photos.prepare(levels.half, {});
  EXPECT_EQ(photos.places(), 4);
  ASSERT_EQ(levels.half.views.size(), 8U);
  int second_half = 0;
  for (std::size_t k = 0; k < 4; ++k) {
    EXPECT_EQ(levels.half.views[k].subset, levels.half.views[k + 4].subset);
    second_half += levels.half.views[k].subset;
  }
  EXPECT_EQ(second_half, 2);
}

TEST(ViewChoice, FindsAnObjectBetweenTheSampledColumns) {
  Scene scene = make_scene(plane, 4);
  Levels levels(scene);
  levels.full.mask = Mask(station_size);
  for (int v = 0; v < station_size.height; ++v)
    for (int u = 81; u < 84; ++u) levels.full.mask(u, v) = 255;
  const Image<float> log_depth(station_size, 1, static_cast<float>(std::log(distance_mm)));
  ViewChoice photos(scene.input, scene.views, test_options(), {});
  photos.choose(levels.full, log_depth);
  EXPECT_NEAR(photos.parallax(levels.full) / (125 / distance_mm * focal), 1, 0.15);
}

}  // namespace
}  // namespace malus
