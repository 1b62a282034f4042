#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <random>

#include "evidence_scene.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/evidence/outline_place_internal.h"
#include "malus/evidence/prior_alignment_internal.h"

namespace malus {
namespace {

constexpr double mm_per_px = 100.0 / 600, degree = std::numbers::pi / 180;

PriorAlignment check(const EvidenceScene& scene, const PointCloud& cloud) {
  return check_alignment(cloud, scene.pose, scene.images(), {});
}

/// A rotation about the object's center (clockwise as displayed), a scaling and a shift in pixels.
Eigen::Affine3d motion(double right_px, double down_px, double clockwise_deg = 0, double scale = 1) {
  const Eigen::Vector3d middle(0, 0, 100);
  Eigen::Affine3d result = Eigen::Affine3d::Identity();
  result.linear() = scale * Eigen::AngleAxisd(clockwise_deg * degree, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  // Scale only across the view, so that the distance does not change.
  result.linear()(2, 2) = 1;
  result.translation() = middle - result.linear() * middle + mm_per_px * Eigen::Vector3d(right_px, down_px, 0);
  return result;
}

TEST(PriorAlignment, ACorrectlyPlacedCloudGivesNoWarning) {
  const EvidenceScene scene;
  const PriorAlignment found = check(scene, scene.cloud);
  EXPECT_EQ(found.finding.severity, Severity::note) << found.finding.text();
  EXPECT_TRUE(found.color.informative);
  EXPECT_TRUE(found.phase.informative);
  EXPECT_LT(std::hypot(found.right_px, found.down_px), 0.7);
  EXPECT_NEAR(found.scale, 1, 0.01);
  EXPECT_NEAR(found.gsd, mm_per_px, 0.005);
  EXPECT_GT(found.object_covered, 0.95);
}

TEST(PriorAlignment, ImagesNarrowerThanAPixelOfTheReducedViewTellNothing) {
  EvidenceScene scene;
  const PixelRect strip{0, 110, 300, 112};
  scene.camera = scene.camera.cropped(strip);
  scene.object = cropped(scene.object, strip);
  scene.depth = cropped(scene.depth, strip);
  scene.everything = cropped(scene.everything, strip);
  for (Image<float>* raster : {&scene.state.i_un, &scene.state.rho, &scene.state.phi})
    *raster = cropped(*raster, strip);
  scene.state.valid = cropped(scene.state.valid, strip);
  EXPECT_FALSE(check(scene, scene.cloud).color.available);
  EXPECT_FALSE(check_alignment(scene.depth, scene.images(), {}).phase.available);
}

TEST(PriorAlignment, NormalsOfZeroLengthAreNotKnown) {
  EvidenceScene scene;
  scene.cloud.normals.clear();
  const PriorAlignment without = check(scene, scene.cloud);
  scene.cloud.normals.assign(scene.cloud.points.size(), Eigen::Vector3f::Zero());
  const PriorAlignment zero = check(scene, scene.cloud);
  EXPECT_EQ(zero.finding.text(), without.finding.text());
  EXPECT_EQ(zero.finding.severity, Severity::note) << zero.finding.text();
  EXPECT_EQ(zero.object_covered, without.object_covered);
  // Half of the normals are known.
  scene.cloud = EvidenceScene().cloud;
  for (std::size_t i = 0; i < scene.cloud.normals.size() / 2; ++i) scene.cloud.normals[i].setZero();
  const PriorAlignment half = check(scene, scene.cloud);
  EXPECT_EQ(half.finding.severity, Severity::note) << half.finding.text();
  EXPECT_GT(half.object_covered, 0.95);
}

TEST(PriorAlignment, ASingleColorTellsNothing) {
  // As scanners without a camera write it. The rounding of dark ones was compared with the images.
  EvidenceScene scene;
  scene.cloud.colors.clear();
  const PriorAlignment without = check(scene, scene.cloud);
  for (const std::uint8_t level : {0, 1, 7, 255}) {
    scene.cloud.colors.assign(scene.cloud.points.size(), Rgb{level, level, level});
    const PriorAlignment found = check(scene, scene.cloud);
    EXPECT_FALSE(found.color.available) << int(level);
    EXPECT_EQ(found.finding.text(), without.finding.text()) << int(level);
  }
  // Nor does a cloud with a single point of another color.
  scene.cloud.colors[scene.cloud.colors.size() / 2] = {250, 250, 250};
  EXPECT_FALSE(check(scene, scene.cloud).color.available);
}

TEST(PriorAlignment, FindsShiftTurnAndSizeByColors) {
  const EvidenceScene scene;
  const PriorAlignment shifted = check(scene, scene.moved(motion(-8, 3)));
  EXPECT_EQ(shifted.finding.severity, Severity::warning) << shifted.finding.text();
  EXPECT_NEAR(shifted.right_px, 8, 0.7);
  EXPECT_NEAR(shifted.down_px, -3, 0.7);
  EXPECT_NE(shifted.finding.message.find("1.3 mm (8 px) too far left"), std::string::npos) << shifted.finding.message;

  const PriorAlignment turned = check(scene, scene.moved(motion(0, 0, 2)));
  EXPECT_EQ(turned.finding.severity, Severity::warning) << turned.finding.text();
  EXPECT_NEAR(turned.clockwise_deg, -2, 0.2);
  EXPECT_NE(turned.finding.message.find("turned by 2.0° clockwise"), std::string::npos) << turned.finding.message;

  const PriorAlignment larger = check(scene, scene.moved(motion(0, 0, 0, 1.06)));
  EXPECT_EQ(larger.finding.severity, Severity::warning) << larger.finding.text();
  EXPECT_NEAR(larger.scale, 1 / 1.06, 0.01);
  EXPECT_NE(larger.finding.message.find("6 % too large"), std::string::npos) << larger.finding.message;
}

TEST(PriorAlignment, StatesTheSmallestDetectableOffsets) {
  const EvidenceScene scene;
  const PriorAlignment right = check(scene, scene.cloud);
  EXPECT_GT(right.detectable_turn_deg, 0);
  EXPECT_LE(right.detectable_turn_deg, 1.5);
  EXPECT_NE(right.finding.message.find(" on would be noticed"), std::string::npos) << right.finding.message;
  for (const double sign : {1, -1}) {
    const PriorAlignment turned = check(scene, scene.moved(motion(0, 0, 1.2 * sign * right.detectable_turn_deg)));
    EXPECT_EQ(turned.finding.severity, Severity::warning) << turned.finding.text();
    const PriorAlignment larger = check(scene, scene.moved(motion(0, 0, 0, 1 + 1.2 * sign * right.detectable_scale)));
    EXPECT_EQ(larger.finding.severity, Severity::warning) << larger.finding.text();
  }
}

/// Rings about the pixel (middle_u, 110), as on a bowl turned on a lathe.
EvidenceScene::Pattern rings(double width_px, double middle_u) {
  return [=](double u, double v) {
    return std::numbers::sqrt2 * std::sin(2 * std::numbers::pi / width_px * std::hypot(u - middle_u, v - 110));
  };
}

EvidenceScene noisy_rings(double middle_u) {
  EvidenceScene scene(rings(40, middle_u), rings(14, middle_u));
  std::mt19937 random(1);
  std::normal_distribution<float> noise(0, 0.15F);
  for (float& intensity : scene.everything) intensity *= 1 + noise(random);
  for (float& phase : scene.state.phi) phase += noise(random);
  return scene;
}

TEST(PriorAlignment, SaysThatATurnOfARoundObjectIsNotDetectable) {
  const EvidenceScene scene = noisy_rings(150);
  const PriorAlignment found = check(scene, scene.cloud);
  EXPECT_EQ(found.detectable_turn_deg, 0);
  EXPECT_GT(found.detectable_shift_px, 0);
  EXPECT_NE(found.finding.message.find("but not a turn"), std::string::npos) << found.finding.message;
}

TEST(PriorAlignment, AShiftOfARoundObjectIsNotTakenForATurn) {
  // The rings' center is far from the center of their visible part: rotating about the visible center shifts the rings.
  const EvidenceScene scene = noisy_rings(240);
  for (const double down_px : {5, -5}) {
    const PriorAlignment found = check(scene, scene.moved(motion(0, down_px)));
    EXPECT_EQ(found.finding.severity, Severity::warning) << found.finding.text();
    EXPECT_EQ(found.clockwise_deg, 0) << found.finding.text();
    EXPECT_NEAR(found.down_px, -down_px, 1) << found.finding.text();
  }
}

/// Depths of a ball whose center lies on the ray of this pixel, in the unit of EvidenceScene's bumps.
EvidenceScene::Pattern ball(double middle_u, double middle_v) {
  return [=](double u, double v) {
    constexpr double radius = 40;
    const double x = mm_per_px * (u - middle_u), y = mm_per_px * (v - middle_v);
    return (radius - std::sqrt(radius * radius - x * x - y * y)) / 0.8;
  };
}

TEST(PriorAlignment, ASmoothBallGivesNoEvidenceFromEdges) {
  EvidenceScene scene(ball(150, 110), nullptr);
  for (float& rho : scene.state.rho) rho = 0;
  // A mask drawn slightly inside the outline, without the place of a stem.
  for (int v = 0; v < scene.object.height(); ++v) {
    for (int u = 0; u < scene.object.width(); ++u) {
      if (scene.object(u, v) == 0) scene.depth(u, v) = std::numeric_limits<float>::quiet_NaN();
      const bool is_inside = std::hypot((u - 150) / 103.0, (v - 110) / 73.0) < 1;
      scene.object(u, v) = is_inside && std::hypot(u - 145, v - 55) > 15 ? 255 : 0;
    }
  }
  const PriorAlignment found = check_alignment(scene.depth, scene.images(), {});
  EXPECT_EQ(found.finding.severity, Severity::note) << found.finding.text();
  EXPECT_FALSE(found.edges.available);
  EXPECT_NE(found.finding.message.find("could not be checked"), std::string::npos) << found.finding.message;
}

TEST(PriorAlignment, AMaskBorderWithinASmoothSurfaceIsNoOutline) {
  const EvidenceScene scene(ball(150, 110), nullptr);
  const PriorAlignment found = check_alignment(scene.depth, scene.images(), {});
  EXPECT_EQ(found.finding.severity, Severity::note) << found.finding.text();
}

TEST(PriorAlignment, FindsShiftByPhasesWithoutColors) {
  const EvidenceScene scene(false);
  EXPECT_EQ(check(scene, scene.cloud).finding.severity, Severity::note);
  const PriorAlignment shifted = check(scene, scene.moved(motion(9, -6)));
  EXPECT_EQ(shifted.finding.severity, Severity::warning) << shifted.finding.text();
  EXPECT_NEAR(shifted.right_px, -9, 1);
  EXPECT_NEAR(shifted.down_px, 6, 1);
}

TEST(PriorAlignment, FindsShiftOfADepthMap) {
  const EvidenceScene scene;
  Image<float> depth = scene.depth;
  for (int v = 0; v < depth.height(); ++v)
    for (int u = 0; u < depth.width(); ++u) depth(u, v) = scene.depth(std::max(u - 10, 0), v);
  EXPECT_EQ(check_alignment(scene.depth, scene.images(), {}).finding.severity, Severity::note);
  const PriorAlignment shifted = check_alignment(depth, scene.images(), {});
  EXPECT_EQ(shifted.finding.severity, Severity::warning) << shifted.finding.text();
  EXPECT_NEAR(shifted.right_px, -10, 1.5);
}

TEST(PriorAlignment, FindsTurnedImages) {
  EvidenceScene scene;
  const auto turn = [](auto& image) { std::reverse(image.begin(), image.end()); };
  turn(scene.state.i_un);
  turn(scene.state.rho);
  turn(scene.state.phi);
  turn(scene.state.valid);
  turn(scene.everything);
  turn(scene.object);
  const PriorAlignment found = check(scene, scene.cloud);
  EXPECT_EQ(found.finding.severity, Severity::warning);
  EXPECT_EQ(found.instead, "the images are turned by 180°") << found.finding.text();
}

TEST(PriorAlignment, FindsMirroredClouds) {
  const EvidenceScene scene;
  Eigen::Affine3d mirror = Eigen::Affine3d::Identity();
  mirror.linear()(0, 0) = -1;
  const PriorAlignment found = check(scene, scene.moved(mirror));
  EXPECT_EQ(found.finding.severity, Severity::warning);
  EXPECT_NE(found.instead.find("mirrored"), std::string::npos) << found.finding.text();
}

TEST(PriorAlignment, FindsOtherUnitsAndPoses) {
  const EvidenceScene scene;
  PointCloud meters = scene.cloud;
  for (Eigen::Vector3d& point : meters.points) point *= 1e-3;
  const PriorAlignment small = check(scene, meters);
  EXPECT_EQ(small.finding.severity, Severity::error);
  EXPECT_NE(why_cloud_misses(meters, scene.pose, scene.camera, scene.object, "mm").find("a factor of 1000"),
            std::string::npos);
  EXPECT_EQ(why_cloud_misses(scene.moved(motion(9000, 0)), scene.pose, scene.camera, scene.object, "mm"), "");
  EXPECT_NE(small.instead.find("the cloud is in m and the camera in mm"), std::string::npos) << small.finding.text();

  const Pose inverse{scene.pose.rotation.transpose(), scene.pose.center()};
  const PriorAlignment other_way = check_alignment(scene.cloud, inverse, scene.images(), {});
  EXPECT_EQ(other_way.finding.severity, Severity::error);
  EXPECT_NE(other_way.instead.find("pose goes the other way"), std::string::npos) << other_way.finding.text();

  PointCloud elsewhere = scene.cloud;
  for (Eigen::Vector3d& point : elsewhere.points) point += Eigen::Vector3d(5000, 9000, 100);
  const PriorAlignment missing = check(scene, elsewhere);
  EXPECT_EQ(missing.finding.severity, Severity::error);
  EXPECT_NE(missing.finding.message.find("0.0 % of it is in the camera's view"), std::string::npos)
      << missing.finding.text();
}

TEST(PriorAlignment, ASparseCloudIsNoMistakeUnlessItLiesElsewhere) {
  EvidenceScene scene(false);
  PointCloud sparse;
  for (std::size_t i = 0; i < scene.cloud.points.size(); i += 97) sparse.points.push_back(scene.cloud.points[i]);
  scene.cloud = sparse;
  const PriorAlignment found = check(scene, scene.cloud);
  EXPECT_EQ(found.finding.severity, Severity::note) << found.finding.text();
  EXPECT_NE(found.finding.message.find("the cloud has only 14"), std::string::npos) << found.finding.text();
  EXPECT_EQ(check(scene, scene.moved(motion(170, 0))).finding.severity, Severity::error);
  for (Eigen::Vector3d& point : scene.cloud.points) point *= 1e-3;
  EXPECT_NE(check(scene, scene.cloud).finding.severity, Severity::note);
}

TEST(PriorAlignment, ACloudTooSparseToCompareIsNotTakenForAMirroredOne) {
  const EvidenceScene scene;
  PointCloud sparse;
  for (const Eigen::Vector3d& point : scene.cloud.points) {
    const Eigen::Vector2d pixel = scene.camera.project(scene.pose.cam_from_world(point));
    if (std::lround(pixel.x()) % 6 == 0 && std::lround(pixel.y()) % 6 == 0) sparse.points.push_back(point);
  }
  const PriorAlignment found = check(scene, sparse);
  EXPECT_EQ(found.finding.severity, Severity::note) << found.finding.text();
  EXPECT_EQ(found.instead, "");
}

/// The scene with a smaller object, the pixels that `keeps` names. Its cloud and its depth map have nothing else.
EvidenceScene reduced_to(const std::function<bool(long u, long v)>& keeps) {
  const EvidenceScene whole;
  EvidenceScene scene = whole;
  scene.cloud = PointCloud();
  for (int v = 0; v < scene.object.height(); ++v) {
    for (int u = 0; u < scene.object.width(); ++u) {
      if (keeps(u, v)) continue;
      scene.object(u, v) = 0;
      scene.state.valid(u, v) = static_cast<std::uint8_t>(PixelState::outside);
      scene.depth(u, v) = std::numeric_limits<float>::quiet_NaN();
    }
  }
  for (std::size_t i = 0; i < whole.cloud.points.size(); ++i) {
    const Eigen::Vector2d pixel = whole.camera.project(whole.pose.cam_from_world(whole.cloud.points[i]));
    if (!keeps(std::lround(pixel.x()), std::lround(pixel.y()))) continue;
    scene.cloud.points.push_back(whole.cloud.points[i]);
    scene.cloud.normals.push_back(whole.cloud.normals[i]);
    scene.cloud.colors.push_back(whole.cloud.colors[i]);
  }
  return scene;
}

TEST(PriorAlignment, SaysThatAnObjectIsTooSmallOrThinToBeCompared) {
  const EvidenceScene coin = reduced_to([](long u, long v) { return std::hypot(u - 150, v - 110) < 12; });
  // Narrower than half a pixel of the reduced view, which therefore shows no object.
  const EvidenceScene pin = reduced_to([](long u, long v) { return u == 151 && std::abs(v - 110) < 50; });
  for (const EvidenceScene* scene : {&coin, &pin}) {
    for (const PriorAlignment& found :
         {check(*scene, scene->cloud), check_alignment(scene->depth, scene->images(), {})}) {
      EXPECT_EQ(found.finding.check, Check::prior);
      EXPECT_EQ(found.finding.severity, Severity::note) << found.finding.text();
      EXPECT_NE(found.finding.message.find("too small in the image"), std::string::npos) << found.finding.text();
      EXPECT_GT(found.object_covered, 0.9);
    }
  }
}

TEST(PriorAlignment, FindsInvertedMasks) {
  EvidenceScene scene;
  for (std::uint8_t& pixel : scene.object) pixel = pixel != 0 ? 0 : 255;
  const PriorAlignment found = check(scene, scene.cloud);
  EXPECT_NE(found.finding.severity, Severity::note);
  EXPECT_EQ(found.instead, "the mask is inverted") << found.finding.text();
}

/// The scene's object in front of a wall. The cloud contains both and has neither colors nor normals.
EvidenceScene before_a_wall() {
  EvidenceScene scene(false);
  for (int v = 0; v < scene.object.height(); ++v)
    for (int u = 0; u < scene.object.width(); ++u)
      if (scene.object(u, v) == 0)
        scene.cloud.points.push_back(scene.pose.world_from_cam(110 * scene.camera.ray(u, v)));
  scene.cloud.normals.clear();
  return scene;
}

TEST(PriorAlignment, UsesTheOutlineWithoutEvidenceFromColorsAndPhases) {
  EvidenceScene scene = before_a_wall();
  for (float& rho : scene.state.rho) rho = 0;
  const PriorAlignment right = check(scene, scene.cloud);
  EXPECT_EQ(right.finding.severity, Severity::note) << right.finding.text();
  EXPECT_GT(right.outline_as_given, 0.8);
  const PriorAlignment shifted = check(scene, scene.moved(motion(12, 0)));
  EXPECT_EQ(shifted.finding.severity, Severity::warning) << shifted.finding.text();
  EXPECT_NE(shifted.finding.message.find("too far right"), std::string::npos) << shifted.finding.message;
  EXPECT_NEAR(shifted.right_px, -12, 4);  // accurate to one pixel of the reduced view
  const PriorAlignment larger = check(scene, scene.moved(motion(0, 0, 0, 1.07)));
  EXPECT_EQ(larger.finding.severity, Severity::warning) << larger.finding.text();
  EXPECT_NE(larger.finding.message.find("% too large"), std::string::npos) << larger.finding.message;
  // Neither the shift, 2.7 % of the object, nor the size is an offset by itself.
  const PriorAlignment both = check(scene, scene.moved(motion(6, 0, 0, 1.025)));
  EXPECT_EQ(both.finding.severity, Severity::warning) << both.finding.text();
  EXPECT_NE(both.finding.message.find("too far right"), std::string::npos) << both.finding.message;
  EXPECT_NE(both.finding.message.find("3 % too large"), std::string::npos) << both.finding.message;
}

TEST(PriorAlignment, FindsInvertedMasksWhereTheCloudCoversTheBackgroundToo) {
  EvidenceScene scene = before_a_wall();
  const PriorAlignment right = check(scene, scene.cloud);
  EXPECT_NE(right.instead, "the mask is inverted") << right.finding.text();
  EXPECT_NEAR(right.outline_step_gsd, 50, 15);  // 60 before smoothing over a pixel of the reduced view
  for (std::uint8_t& pixel : scene.object) pixel = pixel != 0 ? 0 : 255;
  const PriorAlignment found = check(scene, scene.cloud);
  EXPECT_EQ(found.finding.severity, Severity::warning);
  EXPECT_EQ(found.instead, "the mask is inverted") << found.finding.text();
}

TEST(PriorAlignment, AnObjectMissingFromTheCloudGivesNoWarning) {
  const EvidenceScene scene;
  PointCloud around;
  for (int v = 0; v < scene.object.height(); ++v)
    for (int u = 0; u < scene.object.width(); ++u)
      // Keep a distance to the object, because the background grows into it in a reduced view.
      if (std::hypot((u - 150) / 110.0, (v - 110) / 80.0) > 1.12)
        around.points.push_back(scene.pose.world_from_cam(scene.depth(u, v) * scene.camera.ray(u, v)));
  const PriorAlignment found = check(scene, around);
  EXPECT_LT(found.object_covered, 0.1);
  EXPECT_EQ(found.finding.severity, Severity::note) << found.finding.text();
  EXPECT_NE(found.finding.message.find("could not be checked: the cloud covers only"), std::string::npos)
      << found.finding.text();
}

TEST(PriorAlignment, WarnsOfImagesOfAnotherObject) {
  const EvidenceScene scene, other(true, 100);
  const PriorAlignment found = check(scene, other.cloud);
  EXPECT_EQ(found.finding.severity, Severity::warning) << found.finding.text();
  EXPECT_NE(found.finding.message.find("nothing of what the prior shows"), std::string::npos) << found.finding.text();
  EXPECT_LT(found.color.as_given, 0.03);
}

TEST(PriorAlignment, OtherColorsOnTheSameShapeAreACaution) {
  EvidenceScene scene(Waves(1, 25, 80), Waves(2, 6, 30));
  const EvidenceScene twin(Waves(1, 25, 80), Waves(300, 6, 30));
  const PriorAlignment found = check(scene, twin.cloud);
  EXPECT_LT(found.color.as_given, 0.05);
  EXPECT_GT(found.phase.as_given, 0.5);
  EXPECT_EQ(found.finding.severity, Severity::caution) << found.finding.text();
  EXPECT_NE(found.finding.message.find("the cloud's colors have nothing in common"), std::string::npos);
  // High degrees of polarization: a surface that mirrors its surroundings shows their brightness, not the cloud's
  // colors.
  for (float& rho : scene.state.rho) rho = std::min(0.9F, 30 * rho);
  EXPECT_EQ(check(scene, twin.cloud).finding.severity, Severity::note);
}

TEST(PriorAlignment, SaysThatNothingCanBeChecked) {
  const EvidenceScene textured, flat(false);
  PointCloud plane = flat.cloud;
  for (Eigen::Vector3d& point : plane.points) {
    const Eigen::Vector3d x = flat.pose.cam_from_world(point);
    point = flat.pose.world_from_cam(x * (100 / x.z()));
  }
  for (Eigen::Vector3f& normal : plane.normals)
    normal = (flat.pose.rotation.transpose() * Eigen::Vector3d(0, 0, -1)).cast<float>();
  const PriorAlignment found = check(textured, plane);
  EXPECT_EQ(found.finding.severity, Severity::note);
  EXPECT_NE(found.finding.message.find("could not be checked"), std::string::npos) << found.finding.text();
}

TEST(PriorAlignment, ThreadsMakeNoDifference) {
  const EvidenceScene scene;
  const Context two{.threads = 2};
  const PointCloud cloud = scene.moved(motion(5, 2, 1));
  const PriorAlignment a = check_alignment(cloud, scene.pose, scene.images(), {});
  const PriorAlignment b = check_alignment(cloud, scene.pose, scene.images(), two);
  EXPECT_EQ(a.right_px, b.right_px);
  EXPECT_EQ(a.finding.message, b.finding.message);
}

TEST(OutlinePlace, OneStepOfTheSizeIsNoOffsetUnlessTheOutlineIsShiftedToo) {
  OutlinePlace outline{.as_given = 0.81, .at_best = 0.87, .gain_sigmas = 2.2, .place = {}, .extent = 100};
  outline.place.log_scale = 0.025;
  EXPECT_FALSE(outline.is_offset()) << "the edge of a smoothed cloud lies that far beside the object's";
  outline.place.log_scale = 0.05;
  EXPECT_TRUE(outline.is_offset());
  outline.place = {2, 2, 0, 0.025};
  EXPECT_TRUE(outline.is_offset());
  outline.place = {2, 2, 0, 0};
  EXPECT_FALSE(outline.is_offset());
}

}  // namespace
}  // namespace malus
