#include <gtest/gtest.h>

#include <random>
#include <utility>

#include "malus/polarization/phase_coherence_internal.h"
#include "polarizer_scene.h"

namespace malus {
namespace {

PhaseCoherence coherence_of(const PolarizationState& state, const Image<float>& normals) {
  return phase_coherence(phase_cells(state, nullptr, normals, {}));
}

TEST(PhaseCoherence, ExactDataAgreeForDiffuseAndSpecularReflection) {
  for (const bool specular : {false, true}) {
    const PolarizerScene scene(specular);
    const PhaseCoherence found = coherence_of(scene.state(StokesFrame::Identity()), scene.normals);
    EXPECT_LT(found.disagreement, 0.05);
    EXPECT_GT(found.direct, 0.97);
    EXPECT_NEAR(found.turn_rad, 0, 0.1 * degree_rad);
    EXPECT_TRUE(knows_direction(found));
    EXPECT_GT(found.ahead(), 0);
  }
}

TEST(PhaseCoherence, DetectsTurnAndDirection) {
  const PolarizerScene scene;
  const PhaseCoherence turned = coherence_of(scene.state(turned_scale(20 * degree_rad)), scene.normals);
  EXPECT_NEAR(turned.turn_rad / degree_rad, 20, 0.1);
  EXPECT_GT(turned.direct, 0.97);
  EXPECT_GT(turned.disagreement, 0.5);
  const PhaseCoherence behind = coherence_of(scene.state(mirrored_scale()), scene.normals);
  EXPECT_TRUE(knows_direction(behind));
  EXPECT_LT(behind.ahead(), 0);
  EXPECT_NEAR(behind.opposite_turn_rad, 0, 0.1 * degree_rad);
}

TEST(PhaseCoherence, ContradictingADirectionNeedsMoreEvidenceThanConfirmingIt) {
  PhaseCoherence found;
  found.ahead_sigma = 0.1;
  found.direct = 0.85;
  found.opposite = 0.5;
  EXPECT_TRUE(knows_direction(found));
  std::swap(found.direct, found.opposite);
  EXPECT_FALSE(knows_direction(found)) << found.ahead();
  found.opposite = 0.95;
  EXPECT_TRUE(knows_direction(found));
}

/// Waves of random directions and lengths of 25 to 80 px, RMS 1.
Image<float> waves(Size size, std::mt19937& random) {
  std::uniform_real_distribution<double> phase(0, 2 * std::numbers::pi), length(25, 80);
  Image<float> image(size);
  for (int i = 0; i < 12; ++i) {
    const double direction = phase(random), k = 2 * std::numbers::pi / length(random), start = phase(random);
    const double ku = k * std::cos(direction), kv = k * std::sin(direction);
    for (int v = 0; v < size.height; ++v) {
      for (int u = 0; u < size.width; ++u)
        image(u, v) += static_cast<float>(std::sin(ku * u + kv * v + start) / std::sqrt(6.0));
    }
  }
  return image;
}

Image<float> normals_of(const Image<float>& p, const Image<float>& q, double slope) {
  Image<float> normals(p.size(), 3);
  for (int v = 0; v < p.height(); ++v) {
    for (int u = 0; u < p.width(); ++u) {
      const Eigen::Vector3d normal = RayFrame{}.normal({slope * p(u, v), slope * q(u, v)});
      for (int c = 0; c < 3; ++c) normals(u, v, c) = static_cast<float>(normal[c]);
    }
  }
  return normals;
}

TEST(PhaseCoherence, UnrelatedDataDetermineNoDirection) {
  const PolarizerScene scene;
  std::mt19937 random(3);
  double disagreement = 0;
  for (int trial = 0; trial < 20; ++trial) {
    const Image<float> p = waves(scene.size, random), q = waves(scene.size, random);
    const PhaseCoherence found = coherence_of(scene.state(StokesFrame::Identity()), normals_of(p, q, 0.6));
    EXPECT_FALSE(knows_direction(found)) << found.direct << ' ' << found.opposite << ' ' << found.ahead();
    disagreement += found.disagreement / 20;
  }
  EXPECT_NEAR(disagreement, 0.707, 0.03);
}

TEST(PhaseCoherence, UniformPolarizationIsNoAgreement) {
  // A panel that slopes in one direction, lit by a polarized lamp: phases and azimuths both have a preferred direction.
  const PolarizerScene scene;
  std::mt19937 random(5);
  const Image<float> p = waves(scene.size, random), q = waves(scene.size, random);
  Image<float> normals(scene.size, 3);
  PolarizationState state = scene.state(StokesFrame::Identity());
  for (int v = 0; v < scene.size.height; ++v) {
    for (int u = 0; u < scene.size.width; ++u) {
      const Eigen::Vector3d normal = RayFrame{}.normal({0.4 + 0.1 * p(u, v), 0.1 * q(u, v)});
      for (int c = 0; c < 3; ++c) normals(u, v, c) = static_cast<float>(normal[c]);
      state.rho(u, v) = 0.05F;
      state.phi(u, v) = static_cast<float>(std::numbers::pi / 2 + 0.05 * std::sin(0.09 * u - 0.05 * v));
    }
  }
  const PhaseCoherence found = coherence_of(state, normals);
  EXPECT_LT(found.disagreement, 0.5);
  EXPECT_FALSE(knows_direction(found));
}

TEST(PhaseCoherence, StandardDeviationsMatchTheErrors) {
  // The surface's slopes have errors that are correlated between neighbors.
  const PolarizerScene scene;
  const PolarizationState state = scene.state(StokesFrame::Identity());
  std::mt19937 random(11);
  constexpr int trials = 40;
  double squares = 0;
  for (int trial = 0; trial < trials; ++trial) {
    const Image<float> p = waves(scene.size, random), q = waves(scene.size, random);
    Image<float> normals = scene.normals;
    for (int v = 0; v < scene.size.height; ++v) {
      for (int u = 0; u < scene.size.width; ++u) {
        Slopes slopes = RayFrame{}.slopes(Eigen::Vector3d(normals(u, v, 0), normals(u, v, 1), normals(u, v, 2)));
        slopes.p += 0.3 * p(u, v);
        slopes.q += 0.3 * q(u, v);
        const Eigen::Vector3d normal = RayFrame{}.normal(slopes);
        for (int c = 0; c < 3; ++c) normals(u, v, c) = static_cast<float>(normal[c]);
      }
    }
    const PhaseCoherence found = coherence_of(state, normals);
    squares += std::pow(found.turn_rad / found.turn_sigma_rad, 2) / trials;
  }
  EXPECT_GT(std::sqrt(squares), 0.6);
  EXPECT_LT(std::sqrt(squares), 1.4);
}

TEST(PhaseCoherence, IslandsInLessThanFourPlacesHaveNoScatter) {
  const PolarizerScene scene;
  const auto of_corners = [&](int corners) {
    constexpr int side = 20;
    PolarizationState state = scene.state(StokesFrame::Identity());
    state.valid.fill(static_cast<std::uint8_t>(PixelState::outside));
    for (int k = 0; k < corners; ++k) {
      const int u0 = k % 3 == 0 ? 0 : scene.size.width - side, v0 = k % 2 == 0 ? 0 : scene.size.height - side;
      for (int v = v0; v < v0 + side; ++v)
        for (int u = u0; u < u0 + side; ++u) state.valid(u, v) = static_cast<std::uint8_t>(PixelState::valid);
    }
    return coherence_of(state, scene.normals);
  };
  for (const int corners : {2, 3}) {
    const PhaseCoherence found = of_corners(corners);
    EXPECT_GT(found.cells, 50U * static_cast<unsigned>(corners));
    EXPECT_EQ(found.ahead_sigma, 0) << corners;
    EXPECT_FALSE(knows_direction(found)) << corners;
  }
  EXPECT_GT(of_corners(4).ahead_sigma, 0);
}

TEST(PhaseCoherence, ReportsTheSharesOfKnownPhasesAndAzimuths) {
  PolarizerScene scene;
  PolarizationState state = scene.state(StokesFrame::Identity());
  const PhaseCoherence well = coherence_of(state, scene.normals);
  EXPECT_GT(well.azimuths_known, 0.4);
  for (float& degree : state.rho) degree *= 0.01F;
  EXPECT_LT(coherence_of(state, scene.normals).phases_known, 0.1 * well.phases_known);
  EXPECT_EQ(phase_coherence({}).cells, 0u);
  EXPECT_FALSE(knows_direction(phase_coherence({})));
}

}  // namespace
}  // namespace malus
