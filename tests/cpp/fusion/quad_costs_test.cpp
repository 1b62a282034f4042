#include <ceres/loss_function.h>
#include <gtest/gtest.h>

#include <complex>
#include <memory>
#include <random>

#include "malus/fusion/quad_costs_internal.h"
#include "malus/fusion/refinement_weights_internal.h"
#include "malus/fusion/surroundings_internal.h"
#include "synthetic_station.h"

namespace malus {
namespace {

ReflectionModel usual_model() {
  ReflectionModel model;
  model.environment.radiance = {0.15, 0.2, 0.22, 0.3, 0.35, 0.4, 0.38, 0.5, 0.6};
  model.lobe = {0.02, 0.25, Eigen::Vector3d(-0.35, -0.5, -0.8).normalized()};
  model.mirror = {0.15, 14};
  return model;
}

/// A field in the middle of a refinement, with holes and a ragged border, so that some quads are incomplete.
RefinementField rough_field(Reflection kind, const ReflectionModel& model = usual_model()) {
  SyntheticOptions options;
  options.size = {29, 27};
  options.kind = kind;
  options.model = model;
  SyntheticStation station = make_station(options);
  for (const auto& [u, v] : {std::pair{10, 10}, {11, 10}, {12, 11}, {17, 4}, {0, 0}, {5, 20}})
    station.state.valid(u, v) = 0;
  const RefinementImage image = make_image(station.state, station.prior, Context{});
  RefinementField field = image.part(image.everything(), Context{});
  field.kind.fill(kind);
  field.reflection = options.model;
  field.shading << 0.3, 0.1, -0.2, -0.6, 0.05, -0.1, 0.07, 0.04, -0.03;
  std::mt19937 random(5);
  std::normal_distribution<double> gauss(0, 0.2);
  for (std::size_t i = 0; i < field.x.count(); ++i) {
    if (field.object[i]) field.x[i] += gauss(random);
  }
  const WeightOptions weights;
  ResidualSummary summary(field.usable);
  summary.add(update_weights(field, weights, Context{}), {0, field.size().height}, 0);
  field.albedo_weight = summary.albedo_weight(weights);
  return field;
}

/// Largest difference between analytic and numeric derivatives over all costs of a field, relative to the largest
/// derivative of the cost.
double largest_difference(const RefinementField& field, const std::vector<std::unique_ptr<QuadCost>>& costs) {
  double largest = 0;
  for (const auto& cost : costs) {
    std::vector<std::array<double, 4>> values;
    for (const QuadIndex quad : cost->quads()) {
      std::array<double, 4> value{};
      for (int i = 0; i < 4; ++i) {
        const int u = 2 * quad.column + i % 2, v = 2 * quad.row + i / 2;
        if (field.is_object(u, v)) value[static_cast<std::size_t>(i)] = field.x(u, v);
      }
      values.push_back(value);
    }
    std::vector<const double*> parameters;
    for (const auto& value : values) parameters.push_back(value.data());
    const auto residuals = static_cast<std::size_t>(cost->num_residuals());
    std::vector<double> at(residuals), before(residuals), after(residuals);
    std::vector<std::vector<double>> jacobians(values.size(), std::vector<double>(4 * residuals));
    std::vector<double*> pointers;
    for (auto& jacobian : jacobians) pointers.push_back(jacobian.data());
    EXPECT_TRUE(cost->Evaluate(parameters.data(), at.data(), pointers.data()));
    double scale = 1e-12;
    for (const auto& jacobian : jacobians) {
      for (const double derivative : jacobian) scale = std::max(scale, std::abs(derivative));
    }
    constexpr double h = 1e-5;
    for (std::size_t k = 0; k < values.size(); ++k) {
      for (std::size_t i = 0; i < 4; ++i) {
        const double keep = values[k][i];
        values[k][i] = keep - h;
        cost->Evaluate(parameters.data(), before.data(), nullptr);
        values[k][i] = keep + h;
        cost->Evaluate(parameters.data(), after.data(), nullptr);
        values[k][i] = keep;
        for (std::size_t r = 0; r < residuals; ++r) {
          const double numeric = (after[r] - before[r]) / (2 * h);
          largest = std::max(largest, std::abs(numeric - jacobians[k][4 * r + i]) / scale);
        }
      }
    }
  }
  return largest;
}

template <class Make>
std::vector<std::unique_ptr<QuadCost>> all_costs(const RefinementField& field, Make&& make) {
  std::vector<std::unique_ptr<QuadCost>> costs;
  for (int row = 0; 2 * row < field.size().height; ++row) {
    for (int column = 0; 2 * column < field.size().width; ++column) {
      if (nodes_on_object(field, {column, row}) > 0) make(QuadIndex{column, row}, costs);
    }
  }
  return costs;
}

std::vector<std::unique_ptr<QuadCost>> stokes_costs(const RefinementField& field) {
  return all_costs(field, [&](QuadIndex quad, auto& out) {
    for (int i = 0; i < 4; ++i) {
      const int u = 2 * quad.column + i % 2, v = 2 * quad.row + i / 2;
      if (field.is_object(u, v)) out.push_back(std::make_unique<StokesCost>(field, u, v));
    }
  });
}

class QuadCosts : public testing::TestWithParam<Reflection> {};

TEST_P(QuadCosts, StokesDerivativesMatchNumericOnes) {
  const RefinementField field = rough_field(GetParam());
  const auto costs = stokes_costs(field);
  EXPECT_GT(costs.size(), 700u);
  EXPECT_LT(largest_difference(field, costs), 1e-6);
}

TEST(QuadCosts, StokesDerivativesOfAMetalMatchNumericOnes) {
  Surroundings surroundings;
  surroundings.finishes.usual = 0.3;
  surroundings.radiance = Image<float>({Surroundings::cells, Surroundings::cells});
  for (const Surroundings::Cell& cell : Surroundings::all_cells())
    surroundings.radiance(cell.column, cell.row) = static_cast<float>(1 + cell.hx);
  SyntheticOptions small;
  small.size = {29, 27};
  const Pinhole camera = make_station(small).prior.camera;
  ReflectionModel model;
  model.mirrored = std::make_shared<MirroredLightTable>(surroundings, std::complex(0.63, 3.19), camera, Context{});
  model.metal_error = 0.05;
  const RefinementField field = rough_field(Reflection::diffuse, model);
  const auto costs = stokes_costs(field);
  EXPECT_EQ(costs.front()->num_residuals(), 3);
  EXPECT_LT(largest_difference(field, costs), 1e-5);
}

TEST_P(QuadCosts, AlbedoDerivativesMatchNumericOnes) {
  const RefinementField field = rough_field(GetParam());
  const auto costs = all_costs(field, [&](QuadIndex quad, auto& out) {
    for (int i = 0; i < 4; ++i) {
      const int u = 2 * quad.column + i % 2, v = 2 * quad.row + i / 2;
      if (field.is_object(u, v)) out.push_back(std::make_unique<AlbedoCost>(field, u, v));
    }
  });
  EXPECT_LT(largest_difference(field, costs), 1e-6);
}

INSTANTIATE_TEST_SUITE_P(Kinds, QuadCosts, testing::Values(Reflection::diffuse, Reflection::specular));

TEST(QuadCosts, SmoothnessAndPriorDerivativesMatchNumericOnes) {
  const RefinementField field = rough_field(Reflection::diffuse);
  auto costs = all_costs(field, [&](QuadIndex quad, auto& out) {
    out.push_back(std::make_unique<OutsideCost>(field, quad));
    for (const Axis axis : {Axis::u, Axis::v}) out.push_back(std::make_unique<SmoothnessCost>(field, quad, axis, 0.05));
    for (int i = 0; i < 4; ++i) {
      const int u = 2 * quad.column + i % 2, v = 2 * quad.row + i / 2;
      if (field.is_object(u, v)) out.push_back(std::make_unique<SlopeChangeCost>(field, u, v, 4));
    }
  });
  for (int row = 0; row < field.block_count().height; ++row) {
    for (int column = 0; column < field.block_count().width; ++column) {
      costs.push_back(std::make_unique<PriorBlockCost>(field, column, row));
    }
  }
  EXPECT_LT(largest_difference(field, costs), 1e-8);
}

TEST(CentralSlopes, AreExactForAParaboloidAndIgnoreACheckerboard) {
  RefinementField field = rough_field(Reflection::diffuse);
  field.object.fill(255);
  const auto height = [](double u, double v) { return 0.3 * u - 0.2 * v + 0.02 * u * u - 0.03 * u * v + 0.01 * v * v; };
  for (int v = 0; v < field.size().height; ++v) {
    for (int u = 0; u < field.size().width; ++u) field.x(u, v) = height(u - 0.5, v - 0.5) + ((u + v) % 2 == 0 ? 1 : -1);
  }
  const Eigen::Vector2d gradient = central_gradient(field, field.x, 12, 7);
  EXPECT_NEAR(gradient[0], 0.3 + 0.04 * 12 - 0.03 * 7, 1e-12);
  EXPECT_NEAR(gradient[1], -0.2 - 0.03 * 12 + 0.02 * 7, 1e-12);
}

TEST(StokesLoss, IsCauchyTimesTheRegionalWeight) {
  RefinementField field = rough_field(Reflection::diffuse);
  field.regional_weight(3, 3) = 0.25f;
  const ceres::CauchyLoss cauchy(field.robust_scale);
  for (const double squared : {0.0, 0.5, 30.0}) {
    double rho[3], expected[3];
    StokesLoss(field, 3, 3).Evaluate(squared, rho);
    cauchy.Evaluate(squared, expected);
    for (int i = 0; i < 3; ++i) EXPECT_NEAR(rho[i], 0.25 * expected[i], 1e-12);
  }
}

TEST(LogShading, DerivativesMatchNumericOnes) {
  ShadingHarmonics harmonics;
  harmonics << 0.3, 0.1, -0.2, -0.6, 0.05, -0.1, 0.07, 0.04, -0.03;
  const Pinhole camera{{100, 100}, 300, 300, 50, 50};
  const RayFrame frame = ray_frame(&camera, 20, 80);
  const double h = 1e-6;
  const LogShading at = log_shading(harmonics, frame, 0.4, -0.7);
  EXPECT_NEAR(
      at.by_p,
      (log_shading(harmonics, frame, 0.4 + h, -0.7).value - log_shading(harmonics, frame, 0.4 - h, -0.7).value) /
          (2 * h),
      1e-8);
  EXPECT_NEAR(
      at.by_q,
      (log_shading(harmonics, frame, 0.4, -0.7 + h).value - log_shading(harmonics, frame, 0.4, -0.7 - h).value) /
          (2 * h),
      1e-8);
}

}  // namespace
}  // namespace malus
