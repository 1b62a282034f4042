#include "malus/polarization/fresnel.h"

#include <gtest/gtest.h>

#include "degree.h"

namespace malus {
namespace {

const double indices[] = {1.3, 1.4, 1.5, 1.6, 1.7, 1.8};

/// Reflectances as squares of Fresnel's amplitude ratios, written with both angles.
Reflectance<double> textbook(double zenith, double eta) {
  const double refracted = std::asin(std::sin(zenith) / eta);
  const double s = (std::cos(zenith) - eta * std::cos(refracted)) / (std::cos(zenith) + eta * std::cos(refracted));
  const double p = (eta * std::cos(zenith) - std::cos(refracted)) / (eta * std::cos(zenith) + std::cos(refracted));
  return {s * s, p * p};
}

TEST(Fresnel, ReflectancesAreTheTextbookOnes) {
  for (const double eta : indices) {
    for (double zenith = 0; zenith < 90 * degree_rad; zenith += 0.5 * degree_rad) {
      const auto expected = textbook(zenith, eta);
      const auto actual = fresnel_reflectance(std::sin(zenith) * std::sin(zenith), eta);
      EXPECT_NEAR(actual.s, expected.s, 1e-12);
      EXPECT_NEAR(actual.p, expected.p, 1e-12);
    }
  }
}

TEST(Fresnel, Eq6IsTheTransmissionRatio) {
  for (const double eta : indices) {
    for (double zenith = 0; zenith <= 89.5 * degree_rad; zenith += 0.5 * degree_rad) {
      // Light that leaves the body: transmittance = 1 − reflectance; Snell's law relates the angles inside and outside.
      const auto r = textbook(zenith, eta);
      const double expected = ((1 - r.p) - (1 - r.s)) / ((1 - r.p) + (1 - r.s));
      EXPECT_NEAR(diffuse_degree(zenith, eta), expected, 1e-9) << eta << ' ' << zenith / degree_rad;
    }
    EXPECT_NEAR(diffuse_degree(std::numbers::pi / 2, eta), largest_diffuse_degree(eta), 1e-12);
  }
  EXPECT_NEAR(largest_diffuse_degree(1.5), 0.385, 5e-4);
}

TEST(Fresnel, Eq8IsTheReflectionRatio) {
  for (const double eta : indices) {
    for (double zenith = 0.01 * degree_rad; zenith <= 89.9 * degree_rad; zenith += 0.5 * degree_rad) {
      const auto r = textbook(zenith, eta);
      EXPECT_NEAR(specular_degree(zenith, eta), (r.s - r.p) / (r.s + r.p), 1e-9) << eta << ' ' << zenith / degree_rad;
    }
    EXPECT_NEAR(specular_degree(brewster_angle(eta), eta), 1, 1e-12);
  }
}

TEST(Fresnel, Eq7InvertsEq6) {
  for (const double eta : indices) {
    for (double zenith = 0; zenith <= 89 * degree_rad; zenith += 0.25 * degree_rad) {
      const auto inverse = diffuse_zenith(diffuse_degree(zenith, eta), eta);
      EXPECT_FALSE(inverse.clamped);
      EXPECT_NEAR(inverse.zenith_rad / degree_rad, zenith / degree_rad, 1e-6) << eta << ' ' << zenith / degree_rad;
    }
  }
}

TEST(Fresnel, Eq7AsPrintedIsTheCosine) {
  const double n = 1.5;
  for (double zenith = 2 * degree_rad; zenith <= 85 * degree_rad; zenith += degree_rad) {
    const double r = diffuse_degree(zenith, n), n2 = n * n, n3 = n2 * n, n4 = n2 * n2, r2 = r * r;
    const double f =
        std::sqrt((n4 * (1 - r2) + 2 * n2 * (2 * r2 + r - 1) + r2 + 2 * r - 4 * n3 * r * std::sqrt(1 - r2) + 1) /
                  ((r + 1) * (r + 1) * (n4 + 1) + 2 * n2 * (3 * r2 + 2 * r - 1)));
    EXPECT_NEAR(f, std::cos(diffuse_zenith(r, n).zenith_rad), 1e-9);
  }
}

TEST(Fresnel, DegreesBeyondTheModelAreClampedAndFlagged) {
  EXPECT_TRUE(diffuse_zenith(0.4, 1.5).clamped);
  EXPECT_DOUBLE_EQ(diffuse_zenith(0.4, 1.5).zenith_rad, std::numbers::pi / 2);
  EXPECT_TRUE(diffuse_zenith(-0.01, 1.5).clamped);
  EXPECT_EQ(diffuse_zenith(-0.01, 1.5).zenith_rad, 0);
  EXPECT_TRUE(specular_zenith(1.01, 1.5, SpecularBranch::below_brewster).clamped);
  EXPECT_FALSE(specular_zenith(1, 1.5, SpecularBranch::below_brewster).clamped);
}

TEST(Fresnel, SpecularZenithOnBothBranches) {
  for (const double eta : indices) {
    for (double zenith = 0; zenith <= 89 * degree_rad; zenith += 0.25 * degree_rad) {
      const auto branch =
          zenith <= brewster_angle(eta) ? SpecularBranch::below_brewster : SpecularBranch::above_brewster;
      const auto inverse = specular_zenith(specular_degree(zenith, eta), eta, branch);
      // The degree has its maximum at Brewster's angle: a rounding error of 1e-16 there changes the zenith by 1e-8 rad.
      EXPECT_NEAR(inverse.zenith_rad / degree_rad, zenith / degree_rad, 2e-6) << eta << ' ' << zenith / degree_rad;
    }
  }
  EXPECT_NEAR(specular_zenith(0.3, 1.5, SpecularBranch::below_brewster).zenith_rad / degree_rad, 26.4, 0.05);
  EXPECT_NEAR(specular_zenith(0.3, 1.5, SpecularBranch::above_brewster).zenith_rad / degree_rad, 82.3, 0.05);
}

}  // namespace
}  // namespace malus
