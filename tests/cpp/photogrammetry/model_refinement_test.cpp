#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>
#include <utility>
#include <vector>

#include "looking_pose.h"
#include "malus/photogrammetry/model_refinement_internal.h"
#include "malus/photogrammetry/tie_points_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

constexpr double distance = 400;

double height(double x, double y) {
  return 2.5 * std::sin(x / 25) * std::cos(y / 30) + 0.1 * x;
}

/// Reflectance of the surface at (x, y): waves down to a few pixels, not periodic within the view.
double texture(double x, double y) {
  double sum = 0.5, amplitude = 0.1;
  for (int octave = 0; octave < 4; ++octave) {
    const double k = 0.25 * std::pow(1.7, octave), turn = 1.1 * octave;
    const double a = x * std::cos(turn) + y * std::sin(turn), b = y * std::cos(turn) - x * std::sin(turn);
    sum += amplitude * (std::sin(k * a + octave) + std::sin(1.17 * k * b + 2 * octave));
    amplitude *= 0.7;
  }
  return sum;
}

Pose looking_from(const Eigen::Vector3d& center) {
  return looking_pose(center, {0, 0, distance});
}

Eigen::Vector3d on_surface(double x, double y) {
  return {x, y, distance + height(x, y)};
}

/// Where the pixel's ray meets the surface.
Eigen::Vector3d meet(const LensCamera& camera, const Pose& pose, const Eigen::Vector2d& pixel) {
  const Eigen::Vector3d origin = pose.center();
  const Eigen::Vector3d ray = pose.rotation.transpose() * camera.undistort(pixel).homogeneous();
  double t = (distance - origin.z()) / ray.z();
  for (int iteration = 0; iteration < 8; ++iteration) {
    const Eigen::Vector3d at = origin + t * ray;
    t += (distance + height(at.x(), at.y()) - at.z()) / ray.z();
  }
  return origin + t * ray;
}

Image<float> photo(const LensCamera& camera, const Pose& pose, double gain, std::mt19937& random) {
  std::normal_distribution<double> noise(0, 0.004);
  Image<float> image(camera.size);
  for (int v = 0; v < camera.size.height; ++v) {
    for (int u = 0; u < camera.size.width; ++u) {
      const Eigen::Vector3d at = meet(camera, pose, {u, v});
      image(u, v) = static_cast<float>(gain * texture(at.x(), at.y()) + 0.05 + noise(random));
    }
  }
  return image;
}

/// A station that faces the surface and six photos around it. `model` has errors as after matching features.
struct Scene {
  ColmapModel truth, model;
  std::map<std::string, Image<float>> pictures;
};

Pose disturbed(const Pose& pose, std::mt19937& random) {
  std::normal_distribution<double> normal;
  // Turn about a point of the surface, as weakly determined poses do: the image hardly moves.
  const Eigen::Vector3d pivot(0, 0, distance);
  const Eigen::Vector3d turn = 3e-3 * Eigen::Vector3d(normal(random), normal(random), normal(random));
  const Eigen::Matrix3d about = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
  Pose result;
  const Eigen::Vector3d center = pivot + about * (pose.center() - pivot);
  result.rotation = pose.rotation * about.transpose();
  result.translation = -result.rotation * center;
  return result;
}

Scene make_scene() {
  std::mt19937 random(7);
  std::normal_distribution<double> normal;
  Scene scene;
  scene.truth.cameras[1] = {LensModel::opencv, {260, 200}, {560, 556, 128, 101, -0.12, 0.05, 4e-4, -3e-4}};
  scene.truth.cameras[2] = {LensModel::pinhole, {220, 160}, {500, 500, 109, 80}};
  for (std::uint32_t k = 0; k < 7; ++k) {
    const double turn = 2 * std::numbers::pi * k / 6 + 0.3;
    const bool station = k == 6;
    const Eigen::Vector3d center =
        station ? Eigen::Vector3d(5, -4, 0) : Eigen::Vector3d(170 * std::cos(turn), 170 * std::sin(turn), 12.0 * k);
    ColmapImage image{
        station ? "station.png" : "photo_" + std::to_string(k), station ? 2U : 1U, looking_from(center), {}};
    scene.pictures[image.name] = photo(scene.truth.cameras[image.camera_id], image.pose, 0.7 + 0.03 * k, random);
    scene.truth.images[k + 1] = std::move(image);
  }
  std::uniform_real_distribution<double> across(-75, 75), along(-50, 50);
  for (std::uint64_t id = 1; id <= 400; ++id) {
    ColmapPoint point;
    point.position = on_surface(across(random), along(random));
    for (auto& [image_id, image] : scene.truth.images) {
      const Eigen::Vector3d x = image.pose.cam_from_world(point.position);
      const LensCamera& camera = scene.truth.cameras[image.camera_id];
      const Eigen::Vector2d pixel = camera.distort({x.x() / x.z(), x.y() / x.z()});
      if (pixel.x() < 8 || pixel.y() < 8 || pixel.x() > camera.size.width - 9 || pixel.y() > camera.size.height - 9)
        continue;
      point.track.emplace_back(image_id, static_cast<std::uint32_t>(image.keypoints.size()));
      image.keypoints.push_back({pixel + 0.25 * Eigen::Vector2d(normal(random), normal(random)), id});
    }
    scene.truth.points[id] = std::move(point);
  }
  scene.model = scene.truth;
  for (auto& [id, point] : scene.model.points) point.position.z() += 0.3 * normal(random);
  for (auto& [id, image] : scene.model.images) {
    if (id > 1) image.pose = disturbed(image.pose, random);
  }
  return scene;
}

/// The scene of these tests, which is made once.
const Scene& seven_photos() {
  static const Scene scene = make_scene();
  return scene;
}

/// Angle between two rotations, in rad.
double turn(const Pose& a, const Pose& b) {
  return Eigen::AngleAxisd(a.rotation * b.rotation.transpose()).angle();
}

/// Angle error of the station's rotation relative to the first photo's, which does not depend on the datum, in rad.
double station_turn(const ColmapModel& model, const ColmapModel& truth) {
  const Eigen::Matrix3d found = model.images.at(7).pose.rotation * model.images.at(1).pose.rotation.transpose();
  const Eigen::Matrix3d right = truth.images.at(7).pose.rotation * truth.images.at(1).pose.rotation.transpose();
  return Eigen::AngleAxisd(found * right.transpose()).angle();
}

TEST(Refinement, CorrectsTurnedCamerasOfAModelFromFeatures) {
  ColmapModel model = seven_photos().model;
  const double before = station_turn(model, seven_photos().truth);
  const ModelRefinement done = refine_model(model, seven_photos().pictures, "station.png", {}, {}, {});
  EXPECT_EQ(done.status, AdjustmentStatus::converged);
  EXPECT_GT(done.points, 350U);
  EXPECT_GT(done.matches_a_point, 4);
  EXPECT_LT(done.sigma_px, 0.1);
  EXPECT_NEAR(done.adjustment.unit_weight, 1, 0.5);
  const double after = station_turn(model, seven_photos().truth);
  EXPECT_GT(before, 1.5e-3);
  EXPECT_LT(after, before / 3);
  EXPECT_LT(after, 6e-4);
  for (const auto& [id, image] : model.images)
    EXPECT_LT(turn(image.pose, seven_photos().truth.images.at(id).pose), 8e-4) << id;
  // Lenses that are not named stay exactly the same.
  for (const auto& [id, camera] : model.cameras) EXPECT_EQ(camera.params, seven_photos().truth.cameras.at(id).params);
  EXPECT_TRUE(done.lens_sigma.empty());
  for (const auto& [id, point] : model.points) EXPECT_GE(point.error_px, 0);
}

TEST(Refinement, SameWithAnyNumberOfThreads) {
  ColmapModel one = seven_photos().model, four = seven_photos().model;
  refine_model(one, seven_photos().pictures, "station.png", {}, {}, {});
  const Context context{.threads = 2};
  refine_model(four, seven_photos().pictures, "station.png", {}, {}, context);
  for (const auto& [id, image] : one.images) {
    EXPECT_LT((image.pose.translation - four.images.at(id).pose.translation).norm(), 1e-4);
    EXPECT_LT(turn(image.pose, four.images.at(id).pose), 1e-6);
  }
}

TEST(Refinement, CalibratesALensAndStatesItsSigma) {
  ColmapModel model = seven_photos().model;
  std::vector<double>& lens = model.cameras.at(1).params;
  lens[0] += 2;
  lens[1] += 2;
  lens[4] += 0.01;
  const ModelRefinement done =
      refine_model(model, seven_photos().pictures, "station.png", {{1, LensFreedom::all}}, {}, {});
  EXPECT_EQ(done.status, AdjustmentStatus::converged);
  const std::vector<double>& truth = seven_photos().truth.cameras.at(1).params;
  const std::vector<double>& sigma = done.lens_sigma.at(1);
  ASSERT_EQ(sigma.size(), truth.size());
  EXPECT_LT(std::abs(lens[0] - truth[0]), 1);
  for (std::size_t k = 0; k < truth.size(); ++k) {
    EXPECT_GT(sigma[k], 0) << k;
    EXPECT_LT(std::abs(lens[k] - truth[k]), 5 * sigma[k]) << k;
  }

  model = seven_photos().model;
  model.cameras.at(1).params[0] += 2;
  refine_model(model, seven_photos().pictures, "station.png", {{1, LensFreedom::without_principal_point}}, {}, {});
  EXPECT_EQ(model.cameras.at(1).params[2], truth[2]);
  EXPECT_EQ(model.cameras.at(1).params[3], truth[3]);
  EXPECT_NE(model.cameras.at(1).params[0], truth[0] + 2);
}

TEST(Refinement, MatchesWindowsToHundredthsOfAPixel) {
  std::vector<SweepView> views;
  for (const auto& [id, image] : seven_photos().truth.images) {
    views.push_back(
        {seven_photos().pictures.at(image.name), seven_photos().truth.cameras.at(image.camera_id), image.pose});
  }
  std::vector<TiePoint> points;
  for (int k = 0; k < 100; ++k) {
    const double x = -45 + k % 10 * 10, y = -36 + k / 10 * 8, d = 1e-3;
    const Eigen::Vector3d normal((height(x - d, y) - height(x + d, y)) / (2 * d),
                                 (height(x, y - d) - height(x, y + d)) / (2 * d), 1);
    points.push_back({on_surface(x, y), normal.normalized(), 6});
  }
  const std::vector<TieObservation> found = match_tie_points(views, points, {}, {});
  EXPECT_GT(found.size(), 500U);
  std::vector<double> errors;
  Eigen::Vector3d at = Eigen::Vector3d::Zero();
  for (const TieObservation& seen : found) {
    if (seen.view == 6) {
      at = meet(views[6].camera, views[6].pose, seen.pixel);
      continue;
    }
    const Eigen::Vector3d x = views[seen.view].pose.cam_from_world(at);
    errors.push_back((views[seen.view].camera.distort({x.x() / x.z(), x.y() / x.z()}) - seen.pixel).norm());
  }
  std::sort(errors.begin(), errors.end());
  EXPECT_LT(errors[errors.size() / 2], 0.06);
  EXPECT_LT(errors[errors.size() * 95 / 100], 0.25);
}

TEST(Refinement, FollowsByKeypointsWhereAnImageHasNoMatches) {
  Scene scene = seven_photos();
  scene.pictures.at("photo_3").fill(0.4F);
  const double before = station_turn(scene.model, scene.truth);
  const ModelRefinement done = refine_model(scene.model, scene.pictures, "station.png", {}, {}, {});
  EXPECT_EQ(done.status, AdjustmentStatus::converged);
  EXPECT_EQ(done.with_few_matches, std::vector<std::string>{"photo_3"});
  EXPECT_LT(station_turn(scene.model, scene.truth), before / 3);
  EXPECT_LT(turn(scene.model.images.at(4).pose, scene.truth.images.at(4).pose), 2e-3);
}

TEST(Refinement, LeavesAnImageThatSeesTwoPointsWhereItIs) {
  for (const std::uint32_t weak : {1U, 4U}) {  // the first image is also that of the datum
    Scene scene = seven_photos();
    scene.pictures.at(scene.model.images.at(weak).name).fill(0.4F);
    int seen = 0;
    for (auto& [id, point] : scene.model.points)
      std::erase_if(point.track, [&](const auto& at) { return at.first == weak && ++seen > 2; });
    const ColmapModel before = scene.model;
    const ModelRefinement done = refine_model(scene.model, scene.pictures, "station.png", {}, {}, {});
    EXPECT_EQ(done.status, AdjustmentStatus::converged);
    EXPECT_EQ(done.with_few_matches, std::vector<std::string>{before.images.at(weak).name});
    EXPECT_EQ(scene.model.images.at(weak).pose.translation, before.images.at(weak).pose.translation);
    const auto turn_between = [&](const ColmapModel& model) {
      return turn(model.images.at(7).pose, model.images.at(2).pose);
    };
    const double truth = turn_between(scene.truth);
    EXPECT_LT(std::abs(turn_between(scene.model) - truth), std::abs(turn_between(before) - truth) / 3);
    for (const auto& [id, point] : scene.model.points) EXPECT_TRUE(point.position.allFinite());
  }
}

TEST(Refinement, LeavesTheModelWhenNothingMatches) {
  ColmapModel model = seven_photos().model;
  auto pictures = seven_photos().pictures;
  pictures.at("station.png").fill(0.5F);
  const ModelRefinement done = refine_model(model, pictures, "station.png", {}, {}, {});
  EXPECT_EQ(done.status, AdjustmentStatus::too_few_matches);
  EXPECT_EQ(model.images.at(7).pose.translation, seven_photos().model.images.at(7).pose.translation);
}

TEST(Refinement, NamesAPictureThatIsMissingOrOfAnotherSize) {
  ColmapModel model = seven_photos().model;
  auto pictures = seven_photos().pictures;
  pictures.erase("photo_2");
  expect_error(
      ErrorCode::input, [&] { refine_model(model, pictures, "station.png", {}, {}, {}); }, "photo_2");
  pictures["photo_2"] = Image<float>({10, 10});
  expect_error(
      ErrorCode::input, [&] { refine_model(model, pictures, "station.png", {}, {}, {}); }, "260 x 200");
}

TEST(BundleAdjustment, RefusesInvalidAndUnderdeterminedInput) {
  Bundle bundle;
  bundle.lenses.push_back({{LensModel::pinhole, {100, 100}, {100, 100, 50, 50}}, LensFreedom::fixed, {}});
  bundle.views.push_back({0, {}});
  bundle.points.emplace_back(0, 0, 1);
  bundle.observations.push_back({0, 1, {50, 50}, 1});
  expect_error(ErrorCode::input, [&] { adjust_bundle(bundle, {}); });
  bundle.observations[0] = {0, 0, {50, 50}, 0};
  expect_error(ErrorCode::input, [&] { adjust_bundle(bundle, {}); });
  bundle.observations[0].sigma_px = 1;
  expect_error(
      ErrorCode::input, [&] { adjust_bundle(bundle, {}); }, "view 0");
}

}  // namespace
}  // namespace malus
