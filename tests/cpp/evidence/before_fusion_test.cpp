#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "evidence_scene.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/evidence/before_fusion_internal.h"
#include "malus/evidence/contrast_check_internal.h"
#include "malus/evidence/object_size_internal.h"

namespace malus {
namespace {

TEST(PhaseAgreement, ExactDataAgreeEverywhere) {
  const EvidenceScene scene;
  const PhaseAgreement found = phase_agreement(scene.state, &scene.camera, scene.normals, {});
  EXPECT_EQ(found.finding.severity, Severity::note);
  EXPECT_NE(found.finding.message.find("fits the slopes"), std::string::npos) << found.finding.text();
  EXPECT_LT(found.overall.disagreement, 0.05);
  EXPECT_EQ(found.unrelated_share, 0);
  EXPECT_EQ(found.parts.size(), 36u);
}

TEST(PhaseAgreement, WarnsOfAnotherSurface) {
  const EvidenceScene scene;
  const Waves other(5, 25, 80);
  Image<float> depth = scene.depth;
  for (int v = 0; v < depth.height(); ++v)
    for (int u = 0; u < depth.width(); ++u) depth(u, v) = static_cast<float>(100 + 0.8 * other(u, v));
  const PhaseAgreement found =
      phase_agreement(scene.state, &scene.camera, normals_from_depth(depth, scene.camera, {}), {});
  EXPECT_EQ(found.finding.severity, Severity::warning) << found.finding.text();
  EXPECT_NEAR(found.overall.disagreement, 0.707, 0.06);
  EXPECT_GT(found.unrelated_share, 0.1);
  EXPECT_NE(found.finding.text().find("state which one as metal in [optics]"), std::string::npos);
}

TEST(PhaseAgreement, DetectsWrongPolarizerScales) {
  EvidenceScene scene;
  for (float& phi : scene.state.phi) phi = std::fmod(phi + 0.4F, std::numbers::pi_v<float>);
  const PhaseAgreement turned = phase_agreement(scene.state, &scene.camera, scene.normals, {});
  EXPECT_EQ(turned.finding.severity, Severity::warning) << turned.finding.text();
  EXPECT_NEAR(turned.overall.turn_rad, 0.4, 0.02);
  EvidenceScene other_way;
  for (float& phi : other_way.state.phi) phi = std::numbers::pi_v<float> - phi;
  const PhaseAgreement against = phase_agreement(other_way.state, &scene.camera, scene.normals, {});
  EXPECT_EQ(against.finding.severity, Severity::error) << against.finding.text();
}

TEST(PhaseAgreement, ReportsWhenThePhaseCannotBeChecked) {
  const EvidenceScene scene;
  const Image<float> level(scene.camera.size, 1, 100);
  const PhaseAgreement flat =
      phase_agreement(scene.state, &scene.camera, normals_from_depth(level, scene.camera, {}), {});
  EXPECT_NE(flat.finding.message.find("the prior is too flat"), std::string::npos) << flat.finding.text();
  EvidenceScene unpolarized;
  std::mt19937 random(1);
  std::uniform_real_distribution<float> any_phase(0, std::numbers::pi_v<float>);
  for (float& degree : unpolarized.state.rho) degree = 1e-5F;
  for (float& phase : unpolarized.state.phi) phase = any_phase(random);
  const PhaseAgreement weak = phase_agreement(unpolarized.state, &scene.camera, scene.normals, {});
  EXPECT_EQ(weak.finding.severity, Severity::note);
  EXPECT_NE(weak.finding.message.find("too little polarization"), std::string::npos) << weak.finding.text();
}

TEST(PhaseAgreement, CannotBeCheckedOnTwoSmallIslands) {
  EvidenceScene scene;
  const auto is_left = [](int u, int v) { return std::hypot(u - 70, v - 70) < 5; };
  const auto is_right = [](int u, int v) { return std::hypot(u - 230, v - 150) < 5; };
  for (int v = 0; v < scene.object.height(); ++v) {
    for (int u = 0; u < scene.object.width(); ++u) {
      if (!is_left(u, v) && !is_right(u, v)) scene.state.valid(u, v) = static_cast<std::uint8_t>(PixelState::outside);
    }
  }
  const PhaseAgreement found = phase_agreement(scene.state, &scene.camera, scene.normals, {});
  EXPECT_EQ(found.finding.severity, Severity::note);
  EXPECT_NE(found.finding.message.find("could not be checked"), std::string::npos) << found.finding.text();
}

TEST(ObjectSize, DescribesTheSizeAndSuggestsUnitOrFocalLength) {
  const Pinhole camera{{1000, 800}, 2000, 2000, 500, 400};
  const auto size_of = [&](double width, double distance, const std::string& unit) {
    std::vector<Eigen::Vector3d> points;
    for (int i = 0; i <= 1000; ++i)
      points.emplace_back(width * (i / 1000.0 - 0.5), width * 0.5 * (i % 101) / 100.0, distance);
    return object_size(points, camera, unit);
  };
  const ObjectSize vase = size_of(220, 590, "mm");
  EXPECT_NEAR(vase.width, 220, 0.01);
  EXPECT_NEAR(vase.gsd, 0.295, 1e-9);
  EXPECT_EQ(vase.finding.severity, Severity::note);
  EXPECT_EQ(vase.finding.message.substr(0, 26), "the object is 220 mm wide ") << vase.finding.message;
  EXPECT_NE(vase.finding.message.find("0.59 m from the camera; one pixel is 295 µm"), std::string::npos)
      << vase.finding.message;

  const ObjectSize meters = size_of(0.22, 0.59, "mm");
  EXPECT_EQ(meters.finding.severity, Severity::warning);
  EXPECT_NE(meters.finding.suggestion.find("unit = \"m\""), std::string::npos) << meters.finding.text();
  const ObjectSize millimeters = size_of(220, 590, "m");
  EXPECT_EQ(millimeters.finding.severity, Severity::warning);
  EXPECT_NE(millimeters.finding.suggestion.find("unit = \"mm\""), std::string::npos) << millimeters.finding.text();

  const ObjectSize coin_in_meters = size_of(24, 300, "m");
  EXPECT_EQ(coin_in_meters.finding.severity, Severity::warning) << coin_in_meters.finding.text();
  EXPECT_NE(coin_in_meters.finding.suggestion.find("unit = \"mm\""), std::string::npos);

  // An inclined object, mostly on one side of the view: the GSD is taken at the image's center, as in quality.json.
  std::vector<Eigen::Vector3d> inclined;
  for (int i = -20; i <= 200; ++i) inclined.emplace_back(i, 0, 590 + 0.5 * i);
  EXPECT_NEAR(object_size(inclined, camera, "mm").gsd, 0.295, 0.002);
  EXPECT_NEAR(object_size(inclined, camera, "mm").distance, 635, 1);

  const Pinhole wrong_lens{{1000, 800}, 500000, 500000, 500, 400};
  const ObjectSize narrow = object_size({{0, 0, 590}, {1, 1, 590}, {200, 3, 591}}, wrong_lens, "mm");
  EXPECT_NE(narrow.finding.suggestion.find("focal length"), std::string::npos) << narrow.finding.text();
  EXPECT_THROW(object_size({}, camera, "mm"), Error);
}

TEST(ObjectSize, OfARoundObjectIsItsDiameter) {
  // Without the outermost hundredths of its points a coin of 26 mm was one of 24.2 mm. A few wrong depths change
  // nothing.
  const Pinhole camera{{1000, 800}, 2000, 2000, 500, 400};
  std::vector<Eigen::Vector3d> coin, ball;
  for (int v = 0; v < 800; v += 2) {
    for (int u = 0; u < 1000; u += 2) {
      const Eigen::Vector3d ray((u - 500) / 2000.0, (v - 400) / 2000.0, 1);
      if (ray.head<2>().norm() * 100 < 13) coin.push_back(100 * ray);
      const double b = ray.z() * 100, root = b * b - ray.squaredNorm() * (100 * 100 - 13 * 13);
      if (root > 0) ball.push_back((b - std::sqrt(root)) / ray.squaredNorm() * ray);
    }
  }
  for (const std::size_t i : {std::size_t{0}, coin.size() - 1}) coin[i] *= 3;
  EXPECT_NEAR(object_size(coin, camera, "mm").width, 26, 0.25);
  EXPECT_NEAR(object_size(coin, camera, "mm").height, 26, 0.25);
  // What is seen of a ball is a little smaller than its diameter.
  EXPECT_NEAR(object_size(ball, camera, "mm").width, 26 * std::sqrt(1 - 0.13 * 0.13), 0.6);
}

TEST(ObjectSize, APartCutFromAnImageHasThatImagesAngleOfView) {
  const std::vector<Eigen::Vector3d> points{{0, 0, 400}, {1, 1, 400}, {3, 2, 400}};
  const auto severity_of = [&](double cx) {
    const Pinhole part{{260, 200}, 53000, 53000, cx, 100};
    return object_size(points, part, "mm").finding.severity;
  };
  EXPECT_EQ(severity_of(130), Severity::warning) << "0.28°";
  EXPECT_EQ(severity_of(1900), Severity::note) << "cut from the left of an image of 4 degrees";
  EXPECT_EQ(severity_of(-1600), Severity::note);
}

TEST(ObjectSize, WarnsOfDepthsTooCoarseForNormals) {
  const auto found = [](double focal) {
    const Pinhole wide{{14000, 9000}, focal, focal, 7000, 4500};
    return object_size({{0, 0, 3000}, {10, 8, 3001}, {30, 3, 3002}}, wide, "mm").finding;
  };
  EXPECT_EQ(found(2e5).severity, Severity::note) << found(2e5).text();
  const Finding coarse = found(2e6);
  EXPECT_EQ(coarse.severity, Severity::caution) << coarse.text();
  EXPECT_NE(coarse.message.find("2000000"), std::string::npos) << coarse.message;
}

TEST(BeforeFusion, TheSizeIsThatOfAllRowsAndColumns) {
  // Of every third row and column from the image's first one, some of the object's last ones were left out.
  EvidenceScene scene;
  scene.depth.fill(120);
  scene.object.fill(0);
  for_each_pixel(PixelRect{61, 38, 261, 161}, [&](int u, int v) { scene.object(u, v) = 255; });
  const auto findings = findings_before_fusion(
      {.images = scene.images(), .pose = scene.pose, .prior_depth = scene.depth, .cloud = &scene.cloud}, {});
  ASSERT_EQ(findings[0].check, Check::size);
  EXPECT_NEAR(findings[0].figures[0].second, 199 * 0.2, 1e-3);
  EXPECT_NEAR(findings[0].figures[1].second, 122 * 0.2, 1e-3);
}

TEST(BeforeFusion, ListsAllFindings) {
  const EvidenceScene scene;
  const auto findings = findings_before_fusion(
      {.images = scene.images(), .pose = scene.pose, .prior_depth = scene.depth, .cloud = &scene.cloud}, {});
  ASSERT_EQ(findings.size(), 4u);
  EXPECT_EQ(findings[0].check, Check::size);
  EXPECT_EQ(findings[1].check, Check::phase);
  EXPECT_EQ(findings[2].check, Check::prior);
  EXPECT_EQ(findings[3].check, Check::contrast);
  for (const Finding& finding : findings) {
    EXPECT_EQ(finding.severity, Severity::note) << finding.text();
    EXPECT_FALSE(finding.figures.empty());
  }
}

TEST(BeforeFusion, AnInterpolatedPriorThatThePolarizationContradictsIsACaution) {
  const EvidenceScene scene(Waves(1, 10, 30), nullptr), other(Waves(100, 10, 30), nullptr);
  const auto phase_with = [&](const Image<float>& prior_depth, double covered_px) {
    PointCloud cloud;
    for (int v = 0; v < 220; v += 2) {
      for (int u = 0; u < 300; u += 2) {
        if (std::hypot(u - 150, v - 110) < covered_px)
          cloud.points.push_back(scene.pose.world_from_cam(prior_depth(u, v) * scene.camera.ray(u, v)));
      }
    }
    const auto findings = findings_before_fusion(
        {.images = scene.images(), .pose = scene.pose, .prior_depth = prior_depth, .cloud = &cloud}, {});
    return *std::ranges::find(findings, Check::phase, &Finding::check);
  };
  constexpr double everywhere = 300, hardly = 30;
  EXPECT_EQ(phase_with(other.depth, everywhere).severity, Severity::warning);
  const Finding interpolated = phase_with(other.depth, hardly);
  EXPECT_EQ(interpolated.severity, Severity::caution) << interpolated.text();
  EXPECT_NE(interpolated.message.find("interpolated"), std::string::npos) << interpolated.text();
  EXPECT_EQ(phase_with(scene.depth, hardly).severity, Severity::note);
}

TEST(ContrastCheck, ContrastIsProportionalToTheExponent) {
  const auto color_of = [](float exponent) {
    EvidenceScene scene;
    for (float& value : scene.everything) value = std::pow(value, exponent);
    return check_alignment(scene.cloud, scene.pose, scene.images(), {}).color;
  };
  const AlignmentEvidence linear = color_of(1), encoded = color_of(1 / 2.2F);
  EXPECT_GT(linear.contrast,
            1.35);  // 2.2 from the encoding alone; shading, which the colors lack, raises it
  EXPECT_NEAR(encoded.contrast / linear.contrast, 1 / 2.2, 0.08);
}

TEST(ContrastCheck, WarnsOfImagesThatAreNotLinear) {
  const auto finding_of = [](double contrast, double explained, bool known_linear,
                             const std::string& response = "linear") {
    AlignmentEvidence color;
    color.available = true;
    color.at_best = explained;
    color.contrast = contrast;
    return check_contrast(color, Response::of(response).value(), known_linear);
  };
  EXPECT_EQ(finding_of(2.2, 0.6, false).severity, Severity::note);
  const Finding encoded = finding_of(1, 0.6, false), decoded = finding_of(4.8, 0.6, false);
  EXPECT_EQ(encoded.severity, Severity::warning);
  EXPECT_NE(encoded.suggestion.find("srgb"), std::string::npos) << encoded.text();
  EXPECT_EQ(decoded.severity, Severity::warning);
  EXPECT_NE(decoded.message.find("decoded twice"), std::string::npos) << decoded.text();
  EXPECT_NE(finding_of(4.8, 0.6, false, "srgb").suggestion.find("\"linear\""), std::string::npos);
  EXPECT_EQ(finding_of(1.24, 0.47, false).severity, Severity::note) << "the contrast they share may be linear";
  EXPECT_EQ(finding_of(3.6, 0.5, false).severity, Severity::warning) << "closer to decoded twice than to linear";
  EXPECT_EQ(finding_of(1, 0.6, true).severity, Severity::note);
  EXPECT_EQ(finding_of(1, 0.2, false).severity, Severity::note);
  EXPECT_TRUE(finding_of(1, 0.2, false).figures.empty());
}

}  // namespace
}  // namespace malus
