#include <ceres/jet.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <random>

#include "malus/fusion/fresnel_factors_internal.h"
#include "malus/fusion/refinement_field_internal.h"
#include "malus/fusion/reflection_model_internal.h"
#include "malus/polarization/fresnel.h"
#include "malus/polarization/slopes_of_depth_internal.h"

namespace malus {
namespace {

const Pinhole unequal_focal_camera{{640, 480}, 900, 1100, 310.5, 244.25};

TEST(FresnelFactors, AgreeWithTheTextbookAtEveryZenith) {
  for (const double eta : {1.3, 1.5, 1.8}) {
    for (double zenith = 0.02; zenith < 1.5; zenith += 0.07) {
      const double tan2 = std::pow(std::tan(zenith), 2), sin2 = std::pow(std::sin(zenith), 2);
      const FresnelFactors f = fresnel_factors(tan2, eta);
      const Reflectance<double> r = fresnel_reflectance(sin2, eta);
      EXPECT_NEAR(f.reflectance, (r.s + r.p) / 2, 1e-13);
      EXPECT_NEAR(f.specular * tan2, (r.s - r.p) / 2, 1e-12);
      EXPECT_NEAR(f.diffuse * tan2, diffuse_degree(zenith, eta), 1e-12);
    }
  }
}

TEST(FresnelFactors, DerivativesMatchNumericOnes) {
  for (const double tan2 : {0.0, 1e-4, 0.1, 1.0, 4.0, 50.0}) {
    const double h = 1e-6 * std::max(tan2, 1.0);
    const double low = std::max(tan2 - h, 0.0);
    const FresnelFactors f = fresnel_factors(tan2, 1.5), a = fresnel_factors(low, 1.5),
                         b = fresnel_factors(tan2 + h, 1.5);
    const double step = tan2 + h - low, scale = 1e-5;
    EXPECT_NEAR(f.reflectance_slope, (b.reflectance - a.reflectance) / step, scale);
    EXPECT_NEAR(f.diffuse_slope, (b.diffuse - a.diffuse) / step, scale);
    EXPECT_NEAR(f.specular_slope, (b.specular - a.specular) / step, scale);
  }
}

TEST(FresnelFactors, StayFiniteAtGrazingView) {
  const FresnelFactors f = fresnel_factors(1e12, 1.5);
  EXPECT_TRUE(std::isfinite(f.reflectance) && std::isfinite(f.diffuse) && std::isfinite(f.specular));
  EXPECT_EQ(f.diffuse_slope, 0);
}

TEST(SlopesOfLogDepth, AreThoseOfAPlaneSeenInPerspective) {
  const Eigen::Vector3d normal = Eigen::Vector3d(0.3, -0.2, -1).normalized();
  const auto log_depth = [&](double u, double v) {
    return std::log(-700.0 / normal.dot(unequal_focal_camera.ray(u, v)));
  };
  for (const double u : {20.0, 310.0, 600.0}) {
    for (const double v : {15.0, 240.0, 470.0}) {
      const double h = 1e-4, f = unequal_focal_camera.focal();
      const double xu = f * (log_depth(u + h, v) - log_depth(u - h, v)) / (2 * h);
      const double xv = f * (log_depth(u, v + h) - log_depth(u, v - h)) / (2 * h);
      const RayFrame frame = ray_frame(&unequal_focal_camera, u, v);
      const Slopes slopes = slopes_of_log_depth(unequal_focal_camera, frame, u, v, f)(xu, xv);
      EXPECT_NEAR(slopes.p, normal.dot(frame.right) / normal.dot(frame.view), 1e-6);
      EXPECT_NEAR(slopes.q, normal.dot(frame.up) / normal.dot(frame.view), 1e-6);
    }
  }
}

TEST(SlopesOfLogDepth, FrameIsRightHandedWithUpAgainstV) {
  const RayFrame frame = ray_frame(&unequal_focal_camera, 500, 100);
  EXPECT_NEAR((frame.right.cross(frame.up) - frame.view).norm(), 0, 1e-14);
  EXPECT_LT(frame.up.y(), 0);
  EXPECT_GT(frame.right.x(), 0);
}

TEST(EnvironmentProfile, InterpolatesItsNodes) {
  EnvironmentProfile profile;
  for (std::size_t i = 0; i < profile.radiance.size(); ++i) profile.radiance[i] = static_cast<double>(i * i);
  for (std::size_t i = 0; i < profile.radiance.size(); ++i) {
    EXPECT_NEAR(profile.value(EnvironmentProfile::nodes_rad[i]), static_cast<double>(i * i), 1e-12);
  }
  const double middle = 0.5 * (EnvironmentProfile::nodes_rad[2] + EnvironmentProfile::nodes_rad[3]);
  EXPECT_NEAR(profile.value(middle), 6.5, 1e-12);
  EXPECT_NEAR(profile.slope(middle), 5 / (EnvironmentProfile::nodes_rad[3] - EnvironmentProfile::nodes_rad[2]), 1e-9);
}

ReflectionModel everything_on() {
  ReflectionModel model;
  model.eta = 1.47;
  model.environment.radiance = {0.15, 0.2, 0.22, 0.3, 0.35, 0.4, 0.38, 0.5, 0.6};
  model.lobe = {0.4, 0.25, Eigen::Vector3d(-0.35, -0.5, -0.8).normalized()};
  model.mirror = {0.3, 12};
  return model;
}

TEST(PixelReflection, DerivativesMatchNumericOnes) {
  const ReflectionModel model = everything_on();
  std::mt19937 random(3);
  std::uniform_real_distribution<double> slope(-1.6, 1.6);
  for (const Reflection kind : {Reflection::diffuse, Reflection::specular}) {
    for (int i = 0; i < 300; ++i) {
      const double p = slope(random), q = slope(random), h = 1e-6;
      const PixelReflection pixel(model, kind, 0.9, 0.35, ray_frame(&unequal_focal_camera, 100 + i, 400 - i));
      const PredictedStokes m = pixel.predict(p, q);
      const PredictedStokes p0 = pixel.predict(p - h, q), p1 = pixel.predict(p + h, q);
      const PredictedStokes q0 = pixel.predict(p, q - h), q1 = pixel.predict(p, q + h);
      EXPECT_NEAR(m.s1_by_p, (p1.s1 - p0.s1) / (2 * h), 1e-5);
      EXPECT_NEAR(m.s2_by_p, (p1.s2 - p0.s2) / (2 * h), 1e-5);
      EXPECT_NEAR(m.s1_by_q, (q1.s1 - q0.s1) / (2 * h), 1e-5);
      EXPECT_NEAR(m.s2_by_q, (q1.s2 - q0.s2) / (2 * h), 1e-5);
    }
  }
}

/// A second implementation of the forward model, from the textbook functions, for automatic differentiation.
template <class T>
std::array<T, 2> textbook_stokes(const ReflectionModel& model, Reflection kind, double s0, double mirror_body,
                                 const T& p, const T& q) {
  const T g = p * p + q * q, sin2 = g / (1.0 + g), zenith = atan(sqrt(g));
  const Reflectance<T> r = fresnel_reflectance(sin2, model.eta);
  const T reflectance = (r.s + r.p) * 0.5;
  const EnvironmentProfile& profile = model.environment;
  const auto node = static_cast<std::size_t>(EnvironmentProfile::position(zenith.a).node);
  const double slope = profile.slope(zenith.a);
  const T environment = kind == Reflection::diffuse
                            ? profile.radiance[node] + slope * (zenith - EnvironmentProfile::nodes_rad[node])
                            : (s0 - mirror_body) / reflectance;
  const T body = s0 - environment * reflectance;
  const T gain = (body * sin2 * diffuse_degree_over_sin2(sin2, model.eta) - environment * (r.s - r.p) * 0.5) / g;
  return {gain * (p * p - q * q), gain * 2.0 * p * q};
}

TEST(PixelReflection, AgreesWithAutomaticDifferentiationOfTheTextbook) {
  using Jet = ceres::Jet<double, 2>;
  ReflectionModel model = everything_on();
  model.lobe.strength = 0;
  const RayFrame frame = ray_frame(&unequal_focal_camera, 300, 200);
  for (const Reflection kind : {Reflection::diffuse, Reflection::specular}) {
    const PixelReflection pixel(model, kind, 0.9, 0.35, frame);
    for (double p = -1.45; p < 1.5; p += 0.26) {
      for (double q = -1.35; q < 1.5; q += 0.31) {
        const PredictedStokes m = pixel.predict(p, q);
        const std::array<Jet, 2> expected = textbook_stokes(model, kind, 0.9, 0.35, Jet(p, 0), Jet(q, 1));
        EXPECT_NEAR(m.s1, expected[0].a, 1e-12);
        EXPECT_NEAR(m.s2, expected[1].a, 1e-12);
        EXPECT_NEAR(m.s1_by_p, expected[0].v[0], 1e-10);
        EXPECT_NEAR(m.s1_by_q, expected[0].v[1], 1e-10);
        EXPECT_NEAR(m.s2_by_p, expected[1].v[0], 1e-10);
        EXPECT_NEAR(m.s2_by_q, expected[1].v[1], 1e-10);
      }
    }
  }
}

TEST(PixelReflection, PureDiffuseIsEquationSix) {
  ReflectionModel model;
  const double zenith = 0.8, azimuth = 0.6;
  const PixelReflection pixel(model, Reflection::diffuse, 0.7, 0, ray_frame(&unequal_focal_camera, 300, 200));
  const PredictedStokes m = pixel.predict(std::tan(zenith) * std::cos(azimuth), std::tan(zenith) * std::sin(azimuth));
  EXPECT_NEAR(std::hypot(m.s1, m.s2) / 0.7, diffuse_degree(zenith, 1.5), 1e-12);
  EXPECT_NEAR(std::atan2(m.s2, m.s1) / 2, azimuth, 1e-12);
}

TEST(PixelReflection, PureMirrorIsEquationEightAcrossTheAzimuth) {
  ReflectionModel model;
  const double zenith = 0.5, azimuth = 0.3;
  const PixelReflection pixel(model, Reflection::specular, 0.7, 0, ray_frame(&unequal_focal_camera, 300, 200));
  const PredictedStokes m = pixel.predict(std::tan(zenith) * std::cos(azimuth), std::tan(zenith) * std::sin(azimuth));
  EXPECT_NEAR(std::hypot(m.s1, m.s2) / 0.7, specular_degree(zenith, 1.5), 1e-12);
  EXPECT_NEAR(std::cos(std::atan2(m.s2, m.s1) - 2 * azimuth), -1, 1e-12);
}

TEST(PixelReflection, HighlightIsPolarizedAboutTheHalfVector) {
  ReflectionModel model;
  model.lobe = {0.05, 0.2, Eigen::Vector3d(0.5, -0.3, -0.8).normalized()};
  const RayFrame frame = ray_frame(&unequal_focal_camera, 200, 300);
  const LobeAtPixel lobe(model.lobe.light, frame, model.eta);
  // In frontal view there is no diffuse polarization: only the highlight is polarized.
  const PredictedStokes m = PixelReflection(model, Reflection::diffuse, 1, 0, frame).predict(0, 0);
  const double half_azimuth = std::atan2(lobe.hq, lobe.hp);
  EXPECT_GT(std::hypot(m.s1, m.s2), 0);
  EXPECT_NEAR(std::cos(std::atan2(m.s2, m.s1) - 2 * half_azimuth), -1, 1e-9);
  const Eigen::Vector3d half = (model.lobe.light + frame.view).normalized();
  EXPECT_NEAR((frame.normal({lobe.hp, lobe.hq}) - half).norm(), 0, 1e-12);
}

TEST(LobeAtPixel, LightFromBehindGivesNoReflection) {
  const RayFrame frame = ray_frame(&unequal_focal_camera, 310, 240);
  EXPECT_EQ(LobeAtPixel(-frame.view, frame, 1.5).reflectance, 0);
}

}  // namespace
}  // namespace malus
