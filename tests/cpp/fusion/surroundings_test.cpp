#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <memory>
#include <random>

#include "malus/core/median_internal.h"
#include "malus/fusion/fresnel_factors_internal.h"
#include "malus/fusion/refine_internal.h"
#include "malus/fusion/refinement_verdict_internal.h"
#include "malus/fusion/reflection_model_internal.h"
#include "malus/fusion/shading_fit_internal.h"
#include "malus/fusion/shading_internal.h"
#include "malus/fusion/surroundings_course_internal.h"
#include "malus/fusion/surroundings_fit_internal.h"
#include "malus/fusion/surroundings_internal.h"
#include "quick_refinement.h"
#include "synthetic_station.h"
#include "thrown_error.h"

namespace malus {
namespace {

const Pinhole camera{{600, 400}, 1500, 1500, 299.5, 199.5};

Surroundings uniform(double radiance, double roughness) {
  Surroundings surroundings;
  surroundings.finishes.usual = roughness;
  surroundings.radiance = Image<float>({Surroundings::cells, Surroundings::cells});
  for (const Surroundings::Cell& cell : Surroundings::all_cells())
    surroundings.radiance(cell.column, cell.row) = static_cast<float>(radiance);
  return surroundings;
}

/// A bright window to the upper right; weak light from everywhere else.
Surroundings window(double roughness) {
  Surroundings surroundings = uniform(0.2, roughness);
  for (const Surroundings::Cell& cell : Surroundings::all_cells()) {
    if (std::hypot(cell.hx - 0.35, cell.hy - 0.25) < 0.15) surroundings.radiance(cell.column, cell.row) = 5;
  }
  return surroundings;
}

TEST(Surroundings, OfUniformRadianceAreMirroredByFresnelsFactors) {
  // For a smooth mirror under a uniform sky, s0 is Fresnel's reflectance and the polarization follows from the normal.
  const MirroredLightTable table(uniform(1, 0.08), 1.5, camera, Context{});
  const RayFrame frame = ray_frame(&camera, 250, 180);
  for (const double slope : {0.1, 0.4, 0.8}) {
    const FresnelFactors f = fresnel_factors(slope * slope, 1.5);
    const MirroredLight light = table.at(slope, 0, frame);
    EXPECT_NEAR(light.stokes[0] / f.reflectance, 1, 0.1) << slope;
    EXPECT_NEAR(light.stokes[1], -f.specular * slope * slope, 0.1 * f.reflectance) << slope;
    EXPECT_NEAR(light.stokes[2], 0, 0.02 * f.reflectance) << slope;
  }
}

TEST(Surroundings, TableDerivativesMatchNumericOnes) {
  const MirroredLightTable table(window(0.2), 1.5, camera, Context{});
  std::mt19937 random(3);
  std::uniform_real_distribution<double> slope(-1.2, 1.2), column(0, 599), row(0, 399);
  for (int i = 0; i < 200; ++i) {
    const double p = slope(random), q = slope(random), h = 1e-6;
    const RayFrame frame = ray_frame(&camera, column(random), row(random));
    const MirroredLight light = table.at(p, q, frame);
    const Eigen::Vector3d by_p = (table.at(p + h, q, frame).stokes - table.at(p - h, q, frame).stokes) / (2 * h);
    const Eigen::Vector3d by_q = (table.at(p, q + h, frame).stokes - table.at(p, q - h, frame).stokes) / (2 * h);
    EXPECT_LT((light.by_p - by_p).norm(), 1e-5 + 1e-4 * by_p.norm());
    EXPECT_LT((light.by_q - by_q).norm(), 1e-5 + 1e-4 * by_q.norm());
  }
}

TEST(Surroundings, DerivativesOfAPixelsPredictionMatchNumericOnes) {
  ReflectionModel model;
  model.mirrored = std::make_shared<MirroredLightTable>(window(0.2), 1.5, camera, Context{});
  const RayFrame frame = ray_frame(&camera, 400, 100);
  const PixelReflection pixel(model, Reflection::diffuse, 0.9, 0, frame);
  const double h = 1e-6;
  for (const double p : {-0.7, -0.1, 0.3, 0.9}) {
    const PredictedStokes m = pixel.predict(p, 0.2);
    const PredictedStokes after = pixel.predict(p + h, 0.2), before = pixel.predict(p - h, 0.2);
    EXPECT_NEAR(m.s1_by_p, (after.s1 - before.s1) / (2 * h), 1e-4);
    EXPECT_NEAR(m.s2_by_p, (after.s2 - before.s2) / (2 * h), 1e-4);
    EXPECT_GE(m.body, 0);
  }
}

TEST(Surroundings, DerivativesOfAMetalsPredictionMatchNumericOnes) {
  ReflectionModel model;
  model.mirrored = std::make_shared<MirroredLightTable>(window(0.2), std::complex(0.63, 3.19), camera, Context{});
  model.metal_error = 0.1;
  const RayFrame frame = ray_frame(&camera, 400, 100);
  const PixelReflection pixel(model, Reflection::diffuse, 0.9, 0, frame);
  const double h = 1e-6;
  for (const double q : {-0.7, -0.1, 0.3, 0.9}) {
    const PredictedStokes m = pixel.predict(0.2, q);
    const PredictedStokes after = pixel.predict(0.2, q + h), before = pixel.predict(0.2, q - h);
    EXPECT_NEAR(m.mirrored_by_q, (after.mirrored - before.mirrored) / (2 * h), 1e-4);
    EXPECT_NEAR(m.s1_by_q, (after.s1 - before.s1) / (2 * h), 1e-4);
    EXPECT_EQ(m.body, 0);
  }
}

/// Pixels with many slopes and varying body light under a window, with noise and outliers.
std::vector<ReflectionSample> samples_under_window(const MirroredLightTable& table, double index, int count = 3000) {
  std::mt19937 random(5);
  std::normal_distribution<double> slope(0, 0.4), noise(0, 0.001);
  std::uniform_real_distribution<double> body(0.2, 0.6), column(0, 599), row(0, 399);
  std::vector<ReflectionSample> samples;
  for (int i = 0; i < count; ++i) {
    ReflectionSample s;
    const double p = slope(random), q = slope(random);
    s.slopes = {p, q};
    s.frame = ray_frame(&camera, column(random), row(random));
    const MirroredLight light = table.at(p, q, s.frame);
    const double d = body(random), factor = fresnel_factors(s.slopes.tan2(), index).diffuse;
    s.s0 = d + light.stokes[0];
    s.s1 = d * factor * (p * p - q * q) + light.stokes[1] + noise(random);
    s.s2 = d * factor * 2 * p * q + light.stokes[2] + noise(random);
    if (i % 20 == 0) s.s1 += 0.2;
    s.sigma = 0.002;
    samples.push_back(s);
  }
  return samples;
}

TEST(Surroundings, AreEstimatedFromTheirMirrorImage) {
  const Surroundings truth = window(0.2);
  const MirroredLightTable table(truth, 1.5, camera, Context{});
  const std::vector<ReflectionSample> samples = samples_under_window(table, 1.5);
  const std::array<Finishes, 4> tried{{{0.05}, {0.1}, {0.2}, {0.4}}};
  const SurroundingsFit fit = fit_surroundings(samples, {1.5}, tried, {}, Context{});
  EXPECT_EQ(fit.surroundings.finishes.usual, 0.2);
  const MirroredLightTable found(fit.surroundings, 1.5, camera, Context{});
  double error = 0, size = 0;
  for (const ReflectionSample& s : samples) {
    if (s.slopes.tan2() > 0.5) continue;
    const Eigen::Vector3d wanted = table.at(s.slopes.p, s.slopes.q, s.frame).stokes;
    error += (found.at(s.slopes.p, s.slopes.q, s.frame).stokes - wanted).tail<2>().squaredNorm();
    size += wanted.tail<2>().squaredNorm();
  }
  EXPECT_LT(std::sqrt(error / size), 0.1);
  EXPECT_GE(*std::min_element(fit.surroundings.radiance.begin(), fit.surroundings.radiance.end()), 0);
}

TEST(Surroundings, AreDarkWithoutSamples) {
  const std::array<Finishes, 1> tried{{{0.1}}};
  const SurroundingsFit fit = fit_surroundings({}, {1.5}, tried, {}, Context{});
  EXPECT_EQ(*std::max_element(fit.surroundings.radiance.begin(), fit.surroundings.radiance.end()), 0);
}

TEST(Surroundings, AreSmoothDespiteWrongSlopes) {
  const MirroredLightTable table(window(0.2), 1.5, camera, Context{});
  std::vector<ReflectionSample> samples = samples_under_window(table, 1.5);
  std::mt19937 random(7);
  std::normal_distribution<double> error(0, 0.05);
  for (ReflectionSample& s : samples) {
    s.slopes.p += error(random);
    s.slopes.q += error(random);
  }
  const Image<float> map =
      fit_surroundings(samples, {1.5}, std::array{Finishes{0.2}}, {}, Context{}).surroundings.radiance;
  double rough = 0, sum = 0;
  for (int row = 6; row < 14; ++row) {
    for (int column = 6; column < 14; ++column) {
      const double around = map(column - 1, row) + map(column + 1, row) + map(column, row - 1) + map(column, row + 1);
      rough += std::abs(4 * map(column, row) - around);
      sum += 4 * map(column, row);
    }
  }
  EXPECT_LT(rough, 0.8 * sum);
}

TEST(Surroundings, StartingFromAnEarlierMapReachesTheSameCost) {
  const MirroredLightTable table(window(0.2), 1.5, camera, Context{});
  const std::vector<ReflectionSample> samples = samples_under_window(table, 1.5);
  const std::array known{Finishes{0.2}};
  const SurroundingsFit first = fit_surroundings(samples, {1.5}, known, {}, Context{});
  const SurroundingsFit again = fit_surroundings(samples, {1.5}, known, first.surroundings.radiance, Context{});
  EXPECT_NEAR(again.cost, first.cost, 0.01 * first.cost);
}

TEST(Surroundings, BodyShadingIsFittedWithoutTheMirroredLight) {
  // The body is lit from one side only, which first-order harmonics cannot model. The mirrored light is added to it.
  ReflectionModel model;
  model.mirrored = std::make_shared<MirroredLightTable>(window(0.2), 1.5, camera, Context{});
  const MirroredLightTable& table = *model.mirrored;
  std::vector<ReflectionSample> samples = samples_under_window(table, 1.5);
  const Eigen::Vector3d light = Eigen::Vector3d(0.9, -0.1, -0.4).normalized();
  const auto lit = [&](const ReflectionSample& s) {
    return 0.05 + 0.5 * std::max(s.frame.normal(s.slopes).dot(light), 0.0);
  };
  for (ReflectionSample& s : samples) s.s0 = lit(s) + table.at(s.slopes.p, s.slopes.q, s.frame).stokes[0];
  const ShadingHarmonics shading = fit_body_shading(samples, model);
  // Only ratios of shading are known.
  std::vector<double> logs, errors;
  for (const ReflectionSample& s : samples)
    logs.push_back(log_shading(shading, s.frame, s.slopes.p, s.slopes.q).value - std::log(lit(s)));
  const double usual = median(logs);
  for (const double value : logs) errors.push_back(std::abs(value - usual));
  EXPECT_LT(median(errors), 0.1);
}

TEST(Surroundings, MetalsMirrorByFresnelsEquationsWithComplexIndex) {
  const std::complex<double> index(0.63, 3.19);
  for (const double tan2 : {1e-9, 0.1, 1.0, 7.0}) {
    const double c = std::sqrt(1 / (1 + tan2)), s2 = 1 - c * c;
    const std::complex<double> inside = std::sqrt(index * index - s2);
    const double across = std::norm((c - inside) / (c + inside));
    const double along = std::norm((index * index * c - inside) / (index * index * c + inside));
    const MirrorFactors f = mirror_factors(tan2, index);
    EXPECT_NEAR(f.reflectance, 0.5 * (across + along), 1e-12);
    EXPECT_NEAR(f.specular * tan2, 0.5 * (across - along), 1e-12);
  }
}

/// A metal under a window, with bumps that the prior lacks.
SyntheticStation metal_station(const Pinhole& view) {
  SyntheticOptions scene;
  scene.size = {96, 80};
  scene.bump_gsd = 0.5;
  scene.noise = 2e-4;
  scene.model.mirrored = std::make_shared<MirroredLightTable>(window(0.3), std::complex(0.63, 3.19), view, Context{});
  scene.model.metal_error = 0.05;
  return make_station(scene);
}

/// RMS error of the steps in depth from pixel to pixel, away from the border.
double step_error(const Image<float>& depth, const Image<float>& truth) {
  double squares = 0, count = 0;
  for (int v = 4; v < truth.height() - 4; ++v) {
    for (int u = 4; u < truth.width() - 5; ++u) {
      const double step = depth(u + 1, v) - depth(u, v), wanted = truth(u + 1, v) - truth(u, v);
      squares += (step - wanted) * (step - wanted);
      ++count;
    }
  }
  return std::sqrt(squares / count);
}

/// For what is decided before the rounds.
RefineOptions one_round() {
  RefineOptions options = quick();
  options.surroundings_iterations = 1;
  options.more_iterations = 0;
  return options;
}

/// For the resulting surface, which comes to rest, but is not as good as with all rounds.
RefineOptions few_rounds(int rounds) {
  RefineOptions options = quick();
  options.surroundings_iterations = rounds;
  return options;
}

TEST(Surroundings, AMetalIsFoundAndRefinedFromBrightnessAndPolarization) {
  SyntheticOptions scene;
  scene.size = {96, 80};
  const SyntheticStation station = metal_station(make_station(scene).prior.camera);
  const RefineResult result = refine(station.state, station.prior, {}, few_rounds(6), Context{});
  EXPECT_GT(result.report.metal_index.imag(), 0);
  EXPECT_GT(result.report.trusted_share, 0.5);
  EXPECT_TRUE(std::isnan(result.report.mirrored(40, 40))) << "all light is mirrored, in the metal's own color";
  EXPECT_TRUE(std::ranges::any_of(result.surface.warnings, [](const std::string& warning) {
    return warning.find("taken for bare metal") != std::string::npos;
  }));
  EXPECT_LT(step_error(result.surface.depth, station.truth), 0.7 * step_error(station.prior.depth, station.truth));
}

TEST(Surroundings, OfALargerObjectAreFittedAtHalfTheResolutionFirst) {
  SyntheticOptions scene;
  scene.size = {96, 80};
  const SyntheticStation station = metal_station(make_station(scene).prior.camera);
  RefineOptions options = quick();
  options.coarsest_px = 24;
  options.surroundings_iterations = 7;
  const RefineResult result = refine(station.state, station.prior, {}, options, Context{});
  const auto rounds = [&](int binning) {
    return std::ranges::count(result.report.iterations, binning, &RefineIteration::binning);
  };
  EXPECT_EQ(rounds(2), options.surroundings_iterations);
  EXPECT_EQ(rounds(4), 0);
  EXPECT_GT(rounds(1), options.fine_iterations);
  EXPECT_LT(rounds(1), options.surroundings_iterations);
  EXPECT_GT(result.report.metal_index.imag(), 0);
  EXPECT_LT(step_error(result.surface.depth, station.truth), 0.7 * step_error(station.prior.depth, station.truth));
}

bool says(const RefineResult& result, const std::string& words) {
  return std::ranges::any_of(result.surface.warnings,
                             [&](const std::string& warning) { return warning.find(words) != std::string::npos; });
}

/// Without the statement, a stated kind of reflection excludes metals.
TEST(Surroundings, AStatedMetalIsTakenWhereNoneWouldBeFound) {
  SyntheticOptions scene;
  scene.size = {96, 80};
  const SyntheticStation station = metal_station(make_station(scene).prior.camera);
  RefineInput input;
  input.reflection = ReflectionChoice::specular;
  const RefineResult without = refine(station.state, station.prior, input, one_round(), Context{});
  EXPECT_EQ(without.report.metal_index, 0.0);
  EXPECT_FALSE(without.report.stated_metal);
  input.metal = "0.63+3.19i";
  const RefineResult stated = refine(station.state, station.prior, input, few_rounds(5), Context{});
  EXPECT_EQ(stated.report.metal_index, std::complex(0.63, 3.19));
  ASSERT_TRUE(stated.report.stated_metal);
  EXPECT_LT(stated.report.stated_metal->intensity_error, 0.15);
  EXPECT_GT(stated.report.trusted_share, 0.5);
  EXPECT_TRUE(says(stated, "as optics.metal states"));
  EXPECT_FALSE(says(stated, "contradict optics.metal"));
  EXPECT_LT(step_error(stated.surface.depth, station.truth), 0.7 * step_error(station.prior.depth, station.truth));
}

/// A metal whose brightness varies from pixel to pixel, as no map of the surroundings explains.
TEST(Surroundings, AStatedMetalThatTheBrightnessContradictsIsTakenWithAWarning) {
  SyntheticOptions scene;
  scene.size = {96, 80};
  SyntheticStation station = metal_station(make_station(scene).prior.camera);
  for (int v = 0; v < scene.size.height; ++v) {
    for (int u = 0; u < scene.size.width; ++u)
      station.state.i_un(u, v) *= 0.2F + 0.4F * static_cast<float>((u + 2 * v) % 5);
  }
  EXPECT_EQ(refine(station.state, station.prior, {}, one_round(), Context{}).report.metal_index, 0.0);
  RefineInput input;
  input.metal = "bronze";
  const RefineResult stated = refine(station.state, station.prior, input, one_round(), Context{});
  EXPECT_EQ(stated.report.metal_index, std::complex(0.519, 2.415));
  EXPECT_GT(stated.report.stated_metal->intensity_error, 0.25);
  EXPECT_TRUE(says(stated, "contradict optics.metal"));
  EXPECT_NE(stated.surface.confidence.level, ConfidenceLevel::high);
  EXPECT_TRUE(std::ranges::any_of(stated.surface.confidence.reasons, [](const std::string& reason) {
    return reason.find("contradict optics.metal") != std::string::npos;
  }));
}

TEST(Surroundings, AnObjectThatIsStatedToBeNoMetalIsNotTakenForOne) {
  SyntheticOptions scene;
  scene.size = {96, 80};
  const SyntheticStation station = metal_station(make_station(scene).prior.camera);
  RefineInput input;
  input.metal = "none";
  const RefineResult result = refine(station.state, station.prior, input, one_round(), Context{});
  EXPECT_EQ(result.report.metal_index, 0.0);
  EXPECT_FALSE(says(result, "taken for bare metal"));
  EXPECT_FALSE(says(result, "probably bare metal"));
}

TEST(Surroundings, AStatedMetalThatContradictsTheReflectionIsRefused) {
  const SyntheticStation station = make_station({});
  RefineInput input;
  input.metal = "bronze";
  input.reflection = ReflectionChoice::diffuse;
  expect_error(
      ErrorCode::input, [&] { refine(station.state, station.prior, input, quick(), Context{}); },
      "optics.metal = \"bronze\"", "reflection = \"diffuse\"");
}

TEST(Surroundings, AMetalFartherFromThePriorThanItsErrorsKeepsThePrior) {
  SyntheticOptions scene;
  scene.size = {96, 80};
  SyntheticStation station = metal_station(make_station(scene).prior.camera);
  for (float& sigma : station.prior.sigma) sigma *= 0.05F;
  const RefineResult result = refine(station.state, station.prior, {}, few_rounds(3), Context{});
  EXPECT_GT(result.report.metal_index.imag(), 0);
  EXPECT_TRUE(has_settled(result.report)) << "otherwise the prior is kept for that reason";
  EXPECT_LT(result.report.trusted_share, 0.05);
}

TEST(Surroundings, DetermineTheRefractiveIndexOfTheBody) {
  constexpr int few = 1200;
  const auto samples_of = [](double index, double roughness) {
    return samples_under_window(MirroredLightTable(window(roughness), index, camera, Context{}), index, few);
  };
  for (const double index : {1.7, 1.9})
    EXPECT_NEAR(index_of_body(samples_of(index, 0.2), 1.5, {0.2}, Context{}), index, 0.04);
  std::vector<ReflectionSample> of_both = samples_of(1.7, 0.42);
  for (ReflectionSample& s : of_both) s.other_finish = true;
  for (const ReflectionSample& s : samples_of(1.7, 0.08)) of_both.push_back(s);
  EXPECT_NEAR(index_of_body(of_both, 1.5, {0.08, 0.42}, Context{}), 1.7, 0.04) << "samples of two finishes";
  EXPECT_EQ(index_of_body(samples_of(1.5, 0.2), 1.5, {0.2}, Context{}), 1.5) << "the stated index is kept exactly";
}

/// As many slopes as a larger bowl has.
SyntheticOptions small_bowl() {
  SyntheticOptions scene;
  scene.size = {100, 80};
  scene.curvature = 0.0064;
  return scene;
}

TEST(Surroundings, CorrectAStatedIndexThatIsContradicted) {
  SyntheticOptions scene = small_bowl();
  scene.model.eta = 1.8;
  scene.bump_gsd = 0.5;  // small bumps: the prior's slopes are accurate enough to estimate the index
  const Pinhole view = make_station(scene).prior.camera;
  scene.model.mirrored = std::make_shared<MirroredLightTable>(window(0.2), 1.8, view, Context{});
  const SyntheticStation station = make_station(scene);
  RefineOptions options = few_rounds(4);
  const RefineResult corrected = refine(station.state, station.prior, {}, options, Context{});
  ASSERT_TRUE(corrected.report.reflection.mirrored) << "a map of the surroundings must be fitted";
  EXPECT_NEAR(corrected.report.reflection.eta, 1.8, 0.1);
  EXPECT_EQ(corrected.report.stated_eta, 1.5);
  EXPECT_TRUE(std::ranges::any_of(corrected.surface.warnings, [](const std::string& warning) {
    return warning.find("contradicts optics.refractive_index = 1.5") != std::string::npos;
  }));
  options.correct_index = false;
  const RefineResult as_stated = refine(station.state, station.prior, {}, options, Context{});
  EXPECT_EQ(as_stated.report.reflection.eta, 1.5);
  EXPECT_FALSE(as_stated.report.stated_eta);
  EXPECT_LT(step_error(corrected.surface.depth, station.truth), step_error(as_stated.surface.depth, station.truth));
}

/// RMS difference of s1 and s2 between light mirrored from a map and from the true map, over slopes.
double error_of_map(const Surroundings& found, const MirroredLightTable& truth, const Pinhole& view) {
  const MirroredLightTable table(found, 1.5, view, Context{});
  const RayFrame frame = ray_frame(&view, 80, 64);
  double squares = 0, count = 0;
  for (double p = -0.4; p <= 0.4; p += 0.05) {
    for (double q = -0.4; q <= 0.4; q += 0.05) {
      squares += (table.at(p, q, frame).stokes - truth.at(p, q, frame).stokes).tail<2>().squaredNorm();
      ++count;
    }
  }
  return std::sqrt(squares / count);
}

TEST(Surroundings, DoNotFollowASlowBendOfTheSurface) {
  SyntheticOptions scene;
  scene.size = {160, 128};
  scene.bump_gsd = 0;
  const Pinhole view = make_station(scene).prior.camera;
  const auto truth = std::make_shared<MirroredLightTable>(window(0.2), 1.5, view, Context{});
  scene.model.mirrored = truth;
  const SyntheticStation station = make_station(scene);
  RefinementImage image = make_image(station.state, station.prior, Context{});
  image.kind.fill(Reflection::diffuse);
  MapCourse held{{1.5}};
  held.slow_px = 8;
  held.x_prior = image.x;
  // Bend the surface: the bowl becomes deeper.
  for (int v = 0; v < image.size().height; ++v) {
    for (int u = 0; u < image.size().width; ++u) image.x(u, v) += 0.002 * (std::pow(u - 80, 2) + std::pow(v - 64, 2));
  }
  const Image<double> bent = image.x;
  MapCourse free{{1.5}};
  RefineReport of_held, of_free;
  fit_mirrored(image, of_held, held, Context{});
  EXPECT_TRUE(std::ranges::equal(image.x, bent)) << "fitting the map leaves the surface unchanged";
  fit_mirrored(image, of_free, free, Context{});
  EXPECT_LT(error_of_map(of_held.surroundings, *truth, view), 0.5 * error_of_map(of_free.surroundings, *truth, view));
}

TEST(Surroundings, AnUnknownIndexIsNotEstimatedTogetherWithAMap) {
  SyntheticOptions scene = small_bowl();
  const Pinhole view = make_station(scene).prior.camera;
  scene.model.mirrored = std::make_shared<MirroredLightTable>(window(0.2), 1.5, view, Context{});
  const SyntheticStation station = make_station(scene);
  RefineInput input;
  input.refractive_index.reset();
  const RefineResult result = refine(station.state, station.prior, input, one_round(), Context{});
  ASSERT_TRUE(result.report.reflection.mirrored) << "a map of the surroundings must be fitted";
  EXPECT_EQ(result.report.reflection.eta, 1.5);
  EXPECT_EQ(result.report.metal_index, 0.0) << "a body of varying brightness is no metal";
  EXPECT_TRUE(std::isnan(result.report.eta_sigma)) << "must not come from the rejected model";
  EXPECT_TRUE(std::ranges::any_of(result.surface.warnings, [](const std::string& warning) {
    return warning.find("refractive index is not known") != std::string::npos;
  }));
}

}  // namespace
}  // namespace malus
