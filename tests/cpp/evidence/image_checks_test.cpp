#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <functional>
#include <numbers>
#include <random>

#include "degree.h"
#include "malus/core/error.h"
#include "malus/evidence/image_order_internal.h"
#include "malus/evidence/response_check_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

/// Images of varying intensity, degree (up to 0.5) and phase, with noise of 0.3 %, encoded with a response curve.
std::vector<Image<float>> images_at(
    const std::vector<double>& angles_rad, const std::function<double(double)>& curve = [](double x) { return x; }) {
  std::mt19937 random(3);
  std::normal_distribution<double> noise(0, 0.003);
  std::vector<Image<float>> images(angles_rad.size(), Image<float>({120, 90}));
  for (int v = 0; v < 90; ++v) {
    for (int u = 0; u < 120; ++u) {
      const double intensity = 0.3 + 0.2 * std::sin(0.1 * u) * std::cos(0.13 * v);
      const double rho = 0.25 + 0.25 * std::sin(0.05 * u + 0.04 * v), phase = 0.03 * u + 0.05 * v;
      for (std::size_t k = 0; k < angles_rad.size(); ++k) {
        const double light = intensity * (1 + rho * std::cos(2 * (angles_rad[k] - phase)));
        images[k](u, v) = static_cast<float>(curve(light + noise(random)));
      }
    }
  }
  return images;
}

std::vector<double> every(double step_deg, int count) {
  std::vector<double> angles;
  for (int k = 0; k < count; ++k) angles.push_back(k * step_deg * degree_rad);
  return angles;
}

TEST(ImageOrder, SuggestsTheOrderThatFits) {
  const std::vector<double> angles = every(30, 6);
  const ImageOrder right = check_image_order(images_at(angles), angles, {}, {});
  EXPECT_EQ(right.finding.severity, Severity::note);
  EXPECT_EQ(right.angles_rad, angles);
  std::vector<double> shuffled = angles;
  std::swap(shuffled[1], shuffled[4]);
  const ImageOrder wrong = check_image_order(images_at(angles), shuffled, {}, {});
  EXPECT_EQ(wrong.finding.severity, Severity::warning);
  EXPECT_EQ(wrong.angles_rad, angles);
  EXPECT_NE(wrong.finding.suggestion.find("[0, 30, 60, 90, 120, 150]"), std::string::npos) << wrong.finding.text();
}

/// Images of a fine texture in unpolarized light, each shifted to the right by this many pixels.
std::vector<Image<float>> misplaced_images(const std::vector<double>& right_px) {
  std::mt19937 random(5);
  std::normal_distribution<double> noise(0, 0.001);
  std::vector<Image<float>> images(right_px.size(), Image<float>({120, 90}));
  for (int v = 0; v < 90; ++v) {
    for (int u = 0; u < 120; ++u) {
      for (std::size_t k = 0; k < images.size(); ++k) {
        const double texture = std::sin(0.8 * std::numbers::pi * (u - right_px[k]));
        images[k](u, v) = static_cast<float>(0.4 + 0.2 * texture + noise(random));
      }
    }
  }
  return images;
}

TEST(ImageOrder, TextureOfMisregisteredImagesIsNotTakenForPolarization) {
  const std::vector<double> angles = every(30, 6);
  // With the angles in another order, the displacements would be a sinusoid.
  std::vector<double> displacements;
  for (const int k : {0, 3, 1, 5, 4, 2})
    displacements.push_back(0.1 * std::cos(2 * angles[static_cast<std::size_t>(k)]));
  const ImageOrder found = check_image_order(misplaced_images(displacements), angles, {}, {});
  EXPECT_EQ(found.finding.severity, Severity::note) << found.finding.text();
}

TEST(ImageOrder, FindsTwoExchangedImagesAmongMany) {
  const std::vector<double> angles = every(15, 12);
  std::vector<double> shuffled = angles;
  std::swap(shuffled[2], shuffled[7]);
  EXPECT_EQ(check_image_order(images_at(angles), shuffled, {}, {}).angles_rad, angles);
}

TEST(ImageOrder, IsCheckedOnASmallObjectInALargeImage) {
  const std::vector<double> angles = every(30, 6);
  const Size size{500, 400};
  std::vector<Image<float>> images;
  for (const Image<float>& part : images_at(angles)) {
    images.emplace_back(size, 1, 0.3F);
    for (int v = 0; v < part.height(); ++v)
      for (int u = 0; u < part.width(); ++u) images.back()(u + 200, v + 150) = part(u, v);
  }
  Mask object(size);
  for (int v = 150; v < 180; ++v)
    for (int u = 205; u < 235; ++u) object(u, v) = 255;
  std::vector<double> shuffled = angles;
  std::swap(shuffled[1], shuffled[4]);
  EXPECT_EQ(check_image_order(images, angles, object, {}).angles_rad, angles);
  EXPECT_EQ(check_image_order(images, shuffled, object, {}).angles_rad, angles);
}

TEST(ImageOrder, ChecksHundredsOfImages) {
  // 44 850 exchanges; of 400 images, to store and to compute each from nothing takes 250 MB and 10 to 20 s.
  const std::vector<double> angles = every(1.2, 300);
  std::vector<double> shuffled = angles;
  std::swap(shuffled[20], shuffled[110]);
  const std::vector<Image<float>> images = images_at(angles);
  EXPECT_EQ(check_image_order(images, angles, {}, {}).finding.severity, Severity::note);
  EXPECT_EQ(check_image_order(images, shuffled, {}, {}).finding.severity, Severity::warning);
}

TEST(ImageOrder, SaysThatThreeImagesCannotBeChecked) {
  const std::vector<double> angles = every(60, 3);
  const ImageOrder found = check_image_order(images_at(angles), angles, {}, {});
  EXPECT_NE(found.finding.message.find("could not be checked"), std::string::npos);
  EXPECT_THROW(check_image_order(images_at(angles), every(45, 4), {}, {}), Error);
}

TEST(ImageOrder, ReadingSamplesCanBeCanceled) {
  const std::vector<double> angles = every(60, 3);
  const std::atomic<bool> cancel = true;
  const Context context{.cancel = &cancel};
  expect_error(ErrorCode::interrupted, [&] { check_image_order(images_at(angles), angles, {}, context); });
}

TEST(ResponseCheck, DistinguishesLinearEncodedAndTwiceDecodedImages) {
  for (const int count : {4, 6}) {
    const std::vector<double> angles = every(180.0 / count, count);
    const ResponseCheck linear = check_response(images_at(angles), angles, {}, Response{}, {});
    EXPECT_EQ(linear.finding.severity, Severity::note) << linear.finding.text();
    EXPECT_NEAR(linear.bend, 0, 0.02);
    const auto encoded = images_at(angles, [](double x) { return std::pow(std::max(x, 0.0), 1 / 2.2); });
    const ResponseCheck bent = check_response(encoded, angles, {}, Response{}, {});
    EXPECT_EQ(bent.finding.severity, Severity::warning) << bent.bend << " ± " << bent.bend_sigma;
    EXPECT_NE(bent.finding.suggestion.find("srgb"), std::string::npos);
    EXPECT_NEAR(bent.bend, -0.30, 0.06);
    const auto decoded = images_at(angles, [](double x) { return std::pow(std::max(x, 0.0), 2.2); });
    const ResponseCheck twice = check_response(decoded, angles, {}, Response::of("srgb").value(), {});
    EXPECT_EQ(twice.finding.severity, Severity::warning) << twice.bend << " ± " << twice.bend_sigma;
    EXPECT_NEAR(twice.bend, 0.136, 0.04);
    const ResponseCheck otherwise = check_response(decoded, angles, {}, Response{}, {});
    EXPECT_EQ(otherwise.finding.severity, Severity::note) << "no other response may be suggested: " << otherwise.bend;
    EXPECT_FALSE(says_linear(otherwise.finding));
    const ResponseCheck by_one = check_response(decoded, angles, {}, Response::of("gamma:1").value(), {});
    EXPECT_EQ(by_one.finding.severity, Severity::note) << "gamma:1 decodes nothing, either";
  }
}

TEST(ResponseCheck, AnglesFittedToAResponseCurveLeaveTheFindingOpen) {
  Finding linear, bent;
  linear.check = bent.check = Check::response;
  linear.figures = {{"bend", 0.01}, {"bend_sigma", 0.003}};
  bent.figures = {{"bend", 0.13}, {"bend_sigma", 0.003}};
  bent.severity = Severity::warning;
  EXPECT_TRUE(says_linear(response_finding(linear, linear)));
  EXPECT_EQ(response_finding(bent, bent).severity, Severity::warning);
  const Finding unknown = response_finding(bent, linear);
  EXPECT_EQ(unknown.severity, Severity::note);
  EXPECT_FALSE(says_linear(unknown));
  EXPECT_EQ(unknown.figures.front().second, 0.13);
}

TEST(ResponseCheck, SaysThatThreeAnglesCannotBeChecked) {
  // Also if each is taken twice. What is left beside the sinusoid is rounding.
  for (const double step_deg : {30.0, 45.0, 60.0}) {
    std::vector<double> angles = every(step_deg, 3);
    for (int times = 1; times < 3; ++times) {
      const ResponseCheck found = check_response(images_at(angles), angles, {}, Response{}, {});
      EXPECT_EQ(found.finding.severity, Severity::note);
      EXPECT_NE(found.finding.message.find("four different angles"), std::string::npos) << found.finding.text();
      EXPECT_FALSE(says_linear(found.finding));
      for (std::size_t k = 0; k < 3; ++k) angles.push_back(angles[k]);
    }
  }
}

}  // namespace
}  // namespace malus
