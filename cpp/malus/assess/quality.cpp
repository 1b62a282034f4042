#include "malus/assess/quality.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "malus/assess/high_pass.h"
#include "malus/assess/polarization_depth.h"
#include "malus/core/parallel.h"

namespace malus {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double degrees = 180 / std::numbers::pi;

std::vector<double> finite_values(const Image<float>& image, double divisor) {
  std::vector<double> values;
  values.reserve(image.count());
  for (const float value : image) {
    if (std::isfinite(value)) values.push_back(value / divisor);
  }
  return values;
}

double fraction_of(std::size_t part, std::size_t whole) {
  return whole > 0 ? static_cast<double>(part) / static_cast<double>(whole) : nan;
}

void require_sizes(const AssessInput& input) {
  if (input.surface == nullptr) throw input_error("assess: there is no surface to assess");
  const Size size = input.surface->camera.size;
  require_size(input.surface->depth, size, "the fused depth");
  if (!input.surface->sigma.empty()) require_size(input.surface->sigma, size, "the fused sigma");
  if (input.prior != nullptr) {
    require_size(input.prior->depth, size, "the prior depth");
    if (!input.prior->sigma.empty()) require_size(input.prior->sigma, size, "the prior sigma");
  }
  if (input.height != nullptr) require_size(input.height->height, size, "the polarization height");
  if (input.polarization != nullptr) {
    require_size(input.polarization->valid, size, "the polarization validity");
    require_size(input.polarization->rho, size, "the degree of polarization");
    require_size(input.polarization->residual, size, "the polarization residual");
  }
  if (input.object != nullptr) require_size(*input.object, size, "the object mask");
}

bool is_object(const AssessInput& input, std::size_t pixel) {
  if (input.object != nullptr) return (*input.object)[pixel] != 0;
  if (input.polarization != nullptr) {
    return input.polarization->valid[pixel] != static_cast<std::uint8_t>(PixelState::outside);
  }
  return std::isfinite(input.surface->depth[pixel]) ||
         (input.prior != nullptr && std::isfinite(input.prior->depth[pixel]));
}

CoverageFigures measure_coverage(const AssessInput& input) {
  std::size_t object = 0, fused = 0, prior = 0;
  for (std::size_t i = 0; i < input.surface->depth.count(); ++i) {
    if (!is_object(input, i)) continue;
    ++object;
    fused += std::isfinite(input.surface->depth[i]);
    prior += input.prior != nullptr && std::isfinite(input.prior->depth[i]);
  }
  return {static_cast<double>(object), static_cast<double>(fused), fraction_of(fused, object),
          fraction_of(prior, object)};
}

std::optional<SigmaFigures> measure_sigma(const FusedSurface& surface, double gsd, double limit_gsd) {
  if (surface.sigma.empty()) return std::nullopt;
  const std::vector<double> values = finite_values(surface.sigma, gsd);
  const auto below = std::count_if(values.begin(), values.end(), [&](double sigma) { return sigma <= limit_gsd; });
  const double share = fraction_of(static_cast<std::size_t>(below), values.size());
  return SigmaFigures{percentile(values, 0.5), percentile(values, 0.95), limit_gsd, share, 1 - share};
}

struct Spread {
  double rms, mad;
};

Spread detail_of(const Image<float>& depth, double gsd, const AssessOptions& options, const Context& context) {
  std::vector<double> detail = finite_values(high_pass(depth, options.detail_sigma_px, context), gsd);
  const double rms = root_mean_square(detail);
  return {rms, robust_sigma(std::move(detail))};
}

DetailFigures compare_with_prior(const FusedSurface& surface, const DepthPrior& prior, double gsd,
                                 const AssessOptions& options, const Context& context) {
  Image<float> difference(surface.depth.size());
  std::size_t compared = 0, within = 0;
  for (std::size_t i = 0; i < difference.count(); ++i) {
    difference[i] = surface.depth[i] - prior.depth[i];
    if (prior.sigma.empty() || !std::isfinite(difference[i]) || !std::isfinite(prior.sigma[i])) continue;
    ++compared;
    within += std::abs(difference[i]) < 2 * prior.sigma[i];
  }
  const Summary summary = summarize(finite_values(difference, gsd));
  const Spread change = detail_of(difference, gsd, options, context);
  const Spread before = detail_of(prior.depth, gsd, options, context);
  const Spread after = detail_of(surface.depth, gsd, options, context);
  DetailFigures figures;
  figures.difference_rms_gsd = std::sqrt(std::max(summary.rmse * summary.rmse - summary.mean * summary.mean, 0.0));
  figures.difference_bias_gsd = summary.median;
  figures.difference_detail_rms_gsd = change.rms;
  figures.difference_detail_mad_gsd = change.mad;
  figures.prior_detail_rms_gsd = before.rms;
  figures.prior_detail_mad_gsd = before.mad;
  figures.fused_detail_rms_gsd = after.rms;
  figures.fused_detail_mad_gsd = after.mad;
  figures.within_2_prior_sigma_fraction = fraction_of(within, compared);
  return figures;
}

PriorFigures provenance_of(const DepthPrior& prior, double gsd) {
  return {prior.points_total, prior.points_used,  prior.noise,          prior.noise / gsd,
          prior.spacing_px,   prior.smoothing_px, prior.filled_fraction};
}

PolarizationFigures measure_polarization(const AssessInput& input) {
  const PolarizationState& state = *input.polarization;
  std::size_t object = 0;
  std::array<std::size_t, 256> states{};
  std::vector<double> residuals, degrees_of_polarization;
  for (std::size_t i = 0; i < state.valid.count(); ++i) {
    if (!is_object(input, i)) continue;
    ++object;
    ++states[state.valid[i]];
    if (state.valid[i] != static_cast<std::uint8_t>(PixelState::valid)) continue;
    if (std::isfinite(state.residual[i])) residuals.push_back(state.residual[i]);
    if (std::isfinite(state.rho[i])) degrees_of_polarization.push_back(state.rho[i]);
  }
  const auto share = [&](PixelState kind) { return fraction_of(states[static_cast<std::size_t>(kind)], object); };
  PolarizationFigures figures;
  figures.valid_fraction = share(PixelState::valid);
  figures.saturated_fraction = share(PixelState::saturated);
  figures.dark_fraction = share(PixelState::dark);
  figures.misfit_fraction = share(PixelState::misfit);
  figures.residual_median = percentile(residuals, 0.5);
  figures.residual_p95 = percentile(std::move(residuals), 0.95);
  figures.degree_median = percentile(degrees_of_polarization, 0.5);
  figures.degree_p95 = percentile(std::move(degrees_of_polarization), 0.95);
  for (const double angle : state.angles_rad) figures.angles_deg.push_back(angle * degrees);
  figures.exposures = state.exposures;
  return figures;
}

HeightFigures describe_height(const HeightMap& height) {
  HeightFigures figures{
      height.status, height.perspective, height.residual_rms, static_cast<double>(height.unknowns), {}, nan};
  std::copy(height.light.begin(), height.light.end(), figures.light.begin());
  const Eigen::Vector3d light = height.light.head<3>();
  // The camera is at −z from the surface.
  if (light.norm() > 0) figures.light_to_view_deg = degrees * std::acos(std::clamp(-light.normalized().z(), -1.0, 1.0));
  return figures;
}

}  // namespace

double ground_sampling_distance(const Image<float>& depth, const Pinhole& camera) {
  std::vector<double> depths;
  const int centre_u = depth.width() / 2, centre_v = depth.height() / 2;
  for (int v = centre_v - 2; v <= centre_v + 2; ++v) {
    for (int u = centre_u - 2; u <= centre_u + 2; ++u) {
      if (depth.contains(u, v) && std::isfinite(depth(u, v))) depths.push_back(depth(u, v));
    }
  }
  if (depths.empty()) depths = finite_values(depth, 1);
  if (depths.empty()) throw data_error("the surface has no depth at all, so there is nothing to assess");
  return percentile(std::move(depths), 0.5) / camera.focal();
}

Quality assess(const AssessInput& input, const AssessOptions& options, const Context& context) {
  validate_fields(options, "assess");
  require_sizes(input);
  const FusedSurface& surface = *input.surface;
  Quality quality;
  quality.status = surface.status;
  quality.method = surface.method;
  quality.warnings = surface.warnings;
  quality.unit = input.unit;
  quality.width = surface.depth.width();
  quality.height = surface.depth.height();
  quality.gsd = ground_sampling_distance(surface.depth, surface.camera);
  quality.registration_rms_px = input.registration_rms_px;

  context.progress("assess", 0, "coverage and detail");
  quality.coverage = measure_coverage(input);
  quality.sigma = measure_sigma(surface, quality.gsd, options.sigma_limit_gsd);
  if (input.polarization != nullptr) quality.polarization = measure_polarization(input);
  if (input.height != nullptr) quality.polarization_height = describe_height(*input.height);
  if (input.prior != nullptr) {
    quality.prior = provenance_of(*input.prior, quality.gsd);
    quality.prior_vs_fused = compare_with_prior(surface, *input.prior, quality.gsd, options, context);
  }

  context.progress("assess", 0.4, "patches and profiles");
  const bool in_sections = !(input.patches.empty() && input.profiles.empty());
  const Image<float> prior = input.prior != nullptr && in_sections ? input.prior->depth : Image<float>();
  const Image<float> polarization =
      input.height != nullptr && in_sections
          ? depth_from_height(*input.height, input.prior != nullptr ? prior : surface.depth, surface.camera, context)
          : Image<float>();
  const auto fit = [&](const Image<float>& depth, const PatchSpec& patch) {
    return depth.empty() ? std::nullopt : fit_patch(depth, surface.camera, patch, quality.gsd, options, context);
  };
  for (const PatchSpec& patch : input.patches) {
    quality.patches.push_back({patch.name,
                               {patch.x0, patch.y0, patch.x1, patch.y1},
                               fit(prior, patch),
                               fit(polarization, patch),
                               fit(surface.depth, patch)});
  }
  for (const ProfileSpec& profile : input.profiles) {
    quality.profiles.push_back(
        section(profile, prior, polarization, surface.depth, surface.camera, quality.gsd, options, context));
  }
  if (input.reference != nullptr) {
    context.progress("assess", 0.6, "comparing with the reference");
    quality.reference = compare_with_reference(surface, *input.reference, quality.gsd, options, context);
  }
  context.progress("assess", 1);
  return quality;
}

}  // namespace malus
