#include <gtest/gtest.h>

#include <random>

#include "capture/scenes.h"
#include "malus/capture/affine_displacement_internal.h"
#include "malus/capture/registration_internal.h"
#include "malus/capture/registration_verdict_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

constexpr Size registered_size{300, 220};

std::vector<Image<float>> noise_images(std::size_t count, float sigma) {
  std::mt19937 random(7);
  std::normal_distribution<float> normal(0.5f, sigma);
  std::vector<Image<float>> images(count, Image<float>(registered_size));
  for (Image<float>& image : images) {
    for (float& pixel : image) pixel = normal(random);
  }
  return images;
}

std::vector<Image<float>> scene_images(const std::vector<Affine>& maps, double polarization) {
  std::vector<Image<float>> images;
  for (std::size_t k = 0; k < maps.size(); ++k) {
    images.push_back(
        AnalyticScene{polarization}.image(registered_size, maps[k], static_cast<double>(k) * std::numbers::pi / 4));
  }
  return images;
}

const std::vector<Affine> moved_maps{identity_affine(), similarity(registered_size, 0.004, 1.003, 1.3, -0.7),
                                     similarity(registered_size, -0.003, 0.999, -0.45, 0.2),
                                     similarity(registered_size, 0.001, 1, 5.6, -4.4)};

TEST(Registration, finds_affine_maps_of_a_polarized_scene) {
  const auto results = register_images(scene_images(moved_maps, 0.05), NoiseModel{}, {}, two_threads());
  for (std::size_t k = 1; k < 4; ++k) {
    EXPECT_EQ(results[k].status, RegistrationStatus::ok) << results[k].message;
    EXPECT_LT(affine_distance_px(results[k].image_from_base, moved_maps[k], registered_size), 0.02) << k;
    EXPECT_LT(results[k].rms_px, 0.02);
    EXPECT_NEAR(results[k].displacement_px, affine_distance_px(moved_maps[k], identity_affine(), registered_size),
                0.01);
  }
}

TEST(Registration, ignores_exposure_and_a_moving_patch) {
  auto images = scene_images({identity_affine(), moved_maps[1]}, 0.05);
  for (float& pixel : images[1]) pixel *= 0.7f;
  for (int v = 60; v < 110; ++v) {
    for (int u = 60; u < 130; ++u) images[1](u, v) = 0.1f + 0.004f * static_cast<float>((u * 7 + v * 13) % 50);
  }
  const auto results = register_images(images, NoiseModel{}, {}, two_threads());
  EXPECT_EQ(results[1].status, RegistrationStatus::ok) << results[1].message;
  EXPECT_LT(affine_distance_px(results[1].image_from_base, moved_maps[1], registered_size), 0.05);
}

TEST(Registration, differing_polarization_costs_little_accuracy) {
  const auto results = register_images(scene_images(moved_maps, 0.2), NoiseModel{}, {}, two_threads());
  for (std::size_t k = 1; k < 4; ++k) {
    EXPECT_LT(affine_distance_px(results[k].image_from_base, moved_maps[k], registered_size), 0.1) << k;
  }
}

TEST(Registration, identical_images_do_not_move_at_fft_sizes) {
  const Image<float> image = AnalyticScene{0}.image({240, 180}, identity_affine(), 0);
  EXPECT_LT(register_images({image, image}, NoiseModel{}, {}, Context{})[1].displacement_px, 1e-6);
}

TEST(Registration, threads_change_nothing) {
  const auto images = scene_images({moved_maps.begin(), moved_maps.begin() + 2}, 0.1);
  const Context four{.threads = 4};
  const auto one = register_images(images, NoiseModel{}, {}, Context{}),
             many = register_images(images, NoiseModel{}, {}, four);
  EXPECT_NEAR((one[1].image_from_base - many[1].image_from_base).norm(), 0, 1e-9);
}

TEST(Registration, a_part_of_a_large_image_is_enough) {
  // The image has more pixels than registration compares.
  const Size large{1800, 1300};
  const Affine map = similarity(large, 0.0004, 1.0002, 1.7, -0.6);
  std::vector<Image<float>> images;
  for (const Affine& moved : {identity_affine(), map}) {
    images.push_back(AnalyticScene{0}.image(large, moved, 0));
  }
  const auto results = register_images(images, NoiseModel{}, {}, two_threads());
  EXPECT_EQ(results[1].status, RegistrationStatus::ok) << results[1].message;
  EXPECT_LT(affine_distance_px(results[1].image_from_base, map, large), 0.01);
}

TEST(Registration, noise_is_not_texture) {
  const auto results = register_images(noise_images(4, 0.005f), NoiseModel{}, {}, two_threads());
  EXPECT_EQ(results[1].status, RegistrationStatus::no_texture) << results[1].image_from_base;
  EXPECT_EQ(results[1].image_from_base, identity_affine());
  EXPECT_NE(results[1].message.find("texture"), std::string::npos);
}

/// What is said of an image that was moved by 9 px and whose place is known to `rms_px`.
ImageRegistration judged(const RegistrationFigures& figures, double rms_px) {
  ImageRegistration result;
  result.image_from_base = similarity(registered_size, 0, 1, 9, 0);
  result.displacement_px = 9;
  result.rms_px = rms_px;
  judge_registration(result, figures, registered_size, {});
  return result;
}

TEST(Registration, a_search_that_goes_astray_is_not_called_a_lack_of_texture) {
  // Nothing is left that all images show, or they are compared at wrong places.
  for (const auto& [texture, rms_px] : {std::pair{0.0, std::nan("")}, std::pair{0.02, 0.1}, std::pair{0.2, 0.5}}) {
    const ImageRegistration strayed = judged({texture, 0.85, 1, 0}, rms_px);
    EXPECT_EQ(strayed.status, RegistrationStatus::strayed);
    EXPECT_NE(strayed.message.find("went astray"), std::string::npos) << strayed.message;
    EXPECT_NE(strayed.message.find("where they were 85 %"), std::string::npos) << strayed.message;
    EXPECT_EQ(strayed.message.find("texture"), std::string::npos) << strayed.message;
    EXPECT_EQ(strayed.image_from_base, identity_affine());
  }
}

TEST(Registration, noise_and_a_place_that_cannot_be_told_are_told_apart) {
  const ImageRegistration flat = judged({0.02, 0.03, 1, 0}, std::nan(""));
  EXPECT_EQ(flat.status, RegistrationStatus::no_texture);
  EXPECT_NE(flat.message.find("too little texture: 2 %"), std::string::npos) << flat.message;
  EXPECT_EQ(flat.message.find("nan"), std::string::npos) << flat.message;
  const ImageRegistration unsure = judged({0.8, 0.7, 1, 0}, 0.42);
  EXPECT_EQ(unsure.status, RegistrationStatus::uncertain);
  EXPECT_NE(unsure.message.find("known to 0.42 px, expected 0.3 px"), std::string::npos) << unsure.message;
  const ImageRegistration unknown = judged({0.8, 0.7, 1, 0}, std::nan(""));
  EXPECT_EQ(unknown.status, RegistrationStatus::uncertain);
  EXPECT_NE(unknown.message.find("displacement is not known, expected"), std::string::npos) << unknown.message;
  EXPECT_EQ(judged({0.8, 0, 1, 0}, 0.01).status, RegistrationStatus::ok) << "the texture unmoved is not computed then";
}

TEST(Registration, says_that_noise_tells_nothing_of_turns) {
  // Images of a camera that stands still. What has texture is small, or has lines of one direction only; noise fills
  // the rest. Formerly its gradients counted as information, and the images were moved by up to 12 px.
  for (const bool is_patch : {true, false}) {
    std::vector<Image<float>> images = noise_images(6, 0.0045f);
    for (Image<float>& image : images) {
      for_each_pixel(registered_size, [&](int u, int v) {
        if (!is_patch) {
          image(u, v) += 0.03f * std::sin(0.4f * static_cast<float>(u));
        } else if (u >= 120 && u < 180 && v >= 80 && v < 130) {
          image(u, v) += 0.01f * (std::sin(0.5f * static_cast<float>(u)) + std::sin(0.6f * static_cast<float>(v)));
        }
      });
    }
    const auto results = register_images(images, NoiseModel{}, {}, two_threads());
    for (std::size_t k = 1; k < images.size(); ++k) {
      EXPECT_EQ(results[k].status, RegistrationStatus::uncertain) << results[k].message;
      EXPECT_TRUE(results[k].image_from_base.isApprox(identity_affine()));
    }
  }
}

TEST(Registration, flat_images_are_not_registered) {
  const auto results = register_images({3, Image<float>(registered_size, 1, 0.5f)}, NoiseModel{}, {}, Context{});
  EXPECT_EQ(results[2].status, RegistrationStatus::no_texture);
}

TEST(Registration, too_large_a_displacement_is_implausible) {
  RegistrationOptions options;
  options.max_shift = 0.01;
  const auto results =
      register_images(scene_images({identity_affine(), moved_maps[3]}, 0), NoiseModel{}, options, two_threads());
  EXPECT_EQ(results[1].status, RegistrationStatus::implausible);
  EXPECT_NE(results[1].message.find("1 % of the image width"), std::string::npos) << results[1].message;
}

TEST(Registration, images_of_another_scene_are_not_accepted) {
  auto images = scene_images({identity_affine(), identity_affine()}, 0);
  images.push_back(Image<float>(registered_size));
  for (int v = 0; v < registered_size.height; ++v) {
    for (int u = 0; u < registered_size.width; ++u) images[2](u, v) = images[0](registered_size.width - 1 - u, v);
  }
  EXPECT_NE(register_images(images, NoiseModel{}, {}, two_threads())[2].status, RegistrationStatus::ok);
}

TEST(Registration, one_iteration_is_reported_as_not_converged) {
  RegistrationOptions options;
  options.max_iterations = 1;
  const auto results =
      register_images(scene_images({identity_affine(), similarity(registered_size, 0.02, 1.01, 3, 2)}, 0), NoiseModel{},
                      options, two_threads());
  EXPECT_EQ(results[1].status, RegistrationStatus::not_converged);
}

TEST(Registration, sizes_must_agree) {
  expect_error(
      ErrorCode::input,
      [&] {
        register_images({Image<float>({64, 64}), Image<float>({64, 65})}, NoiseModel{}, {}, Context{});
      },
      "64 x 65");
}

TEST(Registration, stops_when_canceled) {
  const std::atomic<bool> cancel{true};
  Context context;
  context.cancel = &cancel;
  expect_error(ErrorCode::interrupted,
               [&] { register_images(scene_images(moved_maps, 0), NoiseModel{}, {}, context); });
}

}  // namespace
}  // namespace malus
