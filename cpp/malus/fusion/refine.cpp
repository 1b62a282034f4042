#include "malus/fusion/refine.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

#include "malus/core/depth_normals.h"
#include "malus/core/parallel.h"
#include "malus/fusion/refinement_field.h"
#include "malus/fusion/refinement_weights.h"
#include "malus/fusion/reflection_fit.h"
#include "malus/fusion/tile_solver.h"

namespace malus {
namespace {

constexpr std::size_t sample_count = 40000;

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

/// Which reflection prevails: the sign of the radial Stokes component at the prior's slopes, weighted by sin²(zenith).
double specular_evidence(const std::vector<ReflectionSample>& samples) {
  double specular = 0, all = 0;
  for (const ReflectionSample& s : samples) {
    const double weight = s.tan2() / (1 + s.tan2());
    all += weight;
    if (s.radial_stokes() < 0) specular += weight;
  }
  return all > 0 ? specular / all : 0;
}

void label_regions(RefinementField& field, const RefineInput& input) {
  auto kind = Reflection::diffuse;
  if (input.reflection == ReflectionChoice::specular) kind = Reflection::specular;
  field.kind.fill(static_cast<std::uint8_t>(kind));
  if (input.reflection != ReflectionChoice::automatic) return;
  if (specular_evidence(collect_samples(field, kind, sample_count)) > 0.5) {
    field.kind.fill(static_cast<std::uint8_t>(Reflection::specular));
  }
}

/// Fits what all pixels share at the current surface. Returns by how much the lobe lowered the robust cost.
double fit_reflection(RefinementField& field, const RefineOptions& options, RefineReport& report) {
  double lobe_gain = 0;
  const auto diffuse = collect_samples(field, Reflection::diffuse, sample_count);
  if (!diffuse.empty()) {
    const Shading shading = fit_shading(diffuse);
    field.shading = shading.harmonics;
    HighlightLobe start = field.reflection.lobe;
    if (start.strength == 0) start.light = shading.light;
    const DiffuseFit fit = fit_diffuse(diffuse, field.reflection.eta, start);
    field.reflection.environment = fit.environment;
    field.reflection.lobe = fit.lobe;
    if (!options.lobe) field.reflection.lobe.strength = 0;
    report.environment_sigma = fit.environment_sigma;
    report.lobe_strength_sigma = fit.strength_sigma;
    report.lobe_roughness_sigma = fit.roughness_sigma;
    report.light_sigma_rad = fit.light_sigma_rad;
    lobe_gain = 1 - fit.cost / std::max(fit.cost_without_lobe, 1e-12);
  }
  const auto specular = collect_samples(field, Reflection::specular, sample_count);
  if (!specular.empty()) {
    const SpecularFit fit = fit_specular(specular, field.reflection.eta);
    field.reflection.mirror = fit.mirror;
    report.mirror_body_sigma = fit.body_sigma;
    report.mirror_environment_sigma = fit.environment_sigma;
  }
  report.reflection = field.reflection;
  return lobe_gain;
}

double rms_change(const Image<double>& now, const Image<double>& before, const Mask& object) {
  double sum = 0, count = 0;
  for (std::size_t i = 0; i < now.count(); ++i) {
    if (!object[i]) continue;
    sum += (now[i] - before[i]) * (now[i] - before[i]);
    ++count;
  }
  return std::sqrt(sum / count);
}

FusedSurface surface_of(const RefinementField& field, const DepthPrior& prior, const Context& context) {
  FusedSurface surface;
  surface.camera = prior.camera;
  surface.pose = prior.pose;
  surface.method = "refined";
  surface.depth = Image<float>(field.size(), 1, std::numeric_limits<float>::quiet_NaN());
  parallel_rows(context, field.size().height, [&](int v) {
    for (int u = 0; u < field.size().width; ++u) {
      if (field.object(u, v)) surface.depth(u, v) = static_cast<float>(field.depth_of(field.x(u, v)));
    }
  });
  surface.normals = normals_from_depth(surface.depth, surface.camera, context);
  surface.sigma = prior.sigma;
  return surface;
}

}  // namespace

RefineResult refine(const PolarizationState& state, const DepthPrior& prior, const RefineInput& input,
                    const RefineOptions& options, const Context& context) {
  const auto start = std::chrono::steady_clock::now();
  validate_fields(options, "fusion");
  RefinementField field = make_field(state, prior, context);
  field.reflection.eta = input.refractive_index.value_or(1.5);
  RefineResult result;
  RefineReport& report = result.report;
  label_regions(field, input);

  const std::vector<Tile> tiles = divide_into_tiles(field.size(), options.tile_px, options.margin_px);
  report.tiles = static_cast<int>(tiles.size());
  const TileOptions tile_options{options.steps, options.smoothness, options.prior_robust_gsd};
  SolveStatistics total;
  for (int i = 0; i < options.iterations; ++i) {
    const auto round_start = std::chrono::steady_clock::now();
    constexpr int fitted_rounds = 6;
    double lobe_gain = 0;
    if (i < fitted_rounds) lobe_gain = fit_reflection(field, options, report);
    const double widening = std::max(1.0, options.graduation * std::pow(0.5, i));
    WeightOptions weights{
        options.robust_scale * widening, options.relative_error, options.slope_error, options.prior_weight,
        options.albedo_weight,           options.albedo_contrast};
    if (options.regional_weights && i >= 4 && lobe_gain > 0.15) weights.regional_sigma_px = 2;
    const FitQuality quality = update_weights(field, weights, context);
    const Image<double> before = field.x;
    const SolveStatistics solved = solve_tiles(field, tiles, tile_options, static_cast<double>(i) / options.iterations,
                                               (i + 1.0) / options.iterations, context);
    total += solved;
    report.iterations.push_back({solved.cost_before, solved.cost_after, quality.robust_cost, quality.median_residual,
                                 rms_change(field.x, before, field.object), solved.rejected_steps,
                                 seconds_since(round_start)});
  }
  result.surface = surface_of(field, prior, context);
  result.surface.status = "converged";
  report.linear_solver_share = total.linear_solver_seconds / std::max(total.solver_seconds, 1e-9);
  report.seconds = seconds_since(start);
  return result;
}

}  // namespace malus
