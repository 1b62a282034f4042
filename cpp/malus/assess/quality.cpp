#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "malus/assess/assessed_confidence_internal.h"
#include "malus/assess/high_pass_internal.h"
#include "malus/assess/polarization_depth_internal.h"
#include "malus/assess/quality_internal.h"
#include "malus/core/degrees_internal.h"
#include "malus/core/dense_systems_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/core/pixel_sums_internal.h"
#include "malus/core/ranked_values_internal.h"
#include "malus/core/robust_spread_internal.h"

namespace malus {
namespace {

RankedValues rank_values(const Image<float>& image, const Context& context) {
  return {image.count(), [&](std::size_t i) { return image[i]; }, context};
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
}

CoverageFigures measure_coverage(const AssessInput& input, const Context& context) {
  const Image<float>& depth = input.surface->depth;
  const auto [object, fused, prior] = sum_pixels<3>(depth.count(), context, [&](std::size_t i, Sums<3>& sums) {
    if (!is_object(input, i)) return;
    sums[0] += 1;
    sums[1] += std::isfinite(depth[i]);
    sums[2] += input.prior != nullptr && std::isfinite(input.prior->depth[i]);
  });
  return {object, fused, fraction_of(fused, object), fraction_of(prior, object)};
}

std::optional<SigmaFigures> measure_sigma(const FusedSurface& surface, double gsd, double limit_gsd,
                                          const Context& context) {
  const Image<float>& sigma = surface.sigma;
  if (sigma.empty()) return std::nullopt;
  RankedValues values = rank_values(sigma, context);
  const auto [below] = sum_pixels<1>(sigma.count(), context, [&](std::size_t i, Sums<1>& sums) {
    sums[0] += std::isfinite(sigma[i]) && sigma[i] / gsd <= limit_gsd;
  });
  const double share = fraction_of(below, static_cast<double>(values.size()));
  const std::vector<double> gsds = percentiles(std::move(values), gsd, {0.5, 0.95});
  return SigmaFigures{gsds[0], gsds[1], limit_gsd, share, 1 - share};
}

struct Spread {
  double rms, mad;
};

Spread detail_of(const Image<float>& detail, double gsd, const Context& context) {
  const auto [squares, count] = sum_pixels<2>(detail.count(), context, [&](std::size_t i, Sums<2>& sums) {
    if (!std::isfinite(detail[i])) return;
    const double value = detail[i] / gsd;
    sums[0] += value * value;
    sums[1] += 1;
  });
  const auto size = [&](std::size_t i) { return std::abs(detail[i]); };
  const double median = percentiles({detail.count(), size, context}, gsd, {0.5})[0];
  return {count > 0 ? std::sqrt(squares / count) : no_value, deviation_per_median * median};
}

/// Plane over the image, value = dot(plane, (1, u, v)), that fits a depth map best in the least-squares sense.
Eigen::Vector3d plane_over_image(const Image<float>& depth, const Context& context) {
  const double mean = finite_mean(depth, context);
  const auto width = static_cast<std::size_t>(depth.width());
  const auto sums = sum_pixels<12>(depth.count(), context, [&](std::size_t i, Sums<12>& part) {
    if (!std::isfinite(depth[i])) return;
    const std::array<double, 4> row{1, static_cast<double>(i % width), static_cast<double>(i / width), depth[i] - mean};
    for (std::size_t j = 0; j < 3; ++j)
      for (std::size_t k = 0; k < 4; ++k) part[4 * j + k] += row[j] * row[k];
  });
  using Rows = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;
  const Rows rows = Eigen::Map<const Rows>(sums.data());
  Eigen::Vector3d plane = solve_symmetric(rows.leftCols<3>(), rows.rightCols<1>());
  plane[0] += mean;
  return plane;
}

Image<float> minus_plane(const Image<float>& depth, const Eigen::Vector3d& plane, const Context& context) {
  Image<float> relief = Image<float>::uninitialized(depth.size());
  parallel_pixels(context, depth.size(), [&](int u, int v) {
    relief(u, v) = static_cast<float>(depth(u, v) - plane.dot(Eigen::Vector3d(1, u, v)));
  });
  return relief;
}

DetailFigures compare_with_prior(const FusedSurface& surface, const DepthPrior& prior, double gsd,
                                 const AssessOptions& options, const Context& context) {
  const Image<float>&fused = surface.depth, &before = prior.depth;
  const auto difference = [&](std::size_t i) { return fused[i] - before[i]; };
  const auto [count, sum, squares] = sum_pixels<3>(fused.count(), context, [&](std::size_t i, Sums<3>& sums) {
    const double value = difference(i) / gsd;
    if (!std::isfinite(value)) return;
    sums[0] += 1;
    sums[1] += value;
    sums[2] += value * value;
  });
  Image<float> change = Image<float>::uninitialized(fused.size());
  for (std::size_t i = 0; i < change.count(); ++i) change[i] = difference(i);
  // Only one raster of detail is in memory at a time.
  const double sigma_px = options.detail_sigma_px;
  const Spread of_change = detail_of(high_pass(std::move(change), sigma_px, context), gsd, context);
  // Of depths, the tilt of the object would count as detail along its contour, where the mean is one-sided.
  const Eigen::Vector3d plane = plane_over_image(fused, context);
  const auto relief_of = [&](const Image<float>& depth) { return minus_plane(depth, plane, context); };
  const Spread of_prior = detail_of(high_pass(relief_of(before), sigma_px, context), gsd, context);
  const Spread of_fused = detail_of(high_pass(relief_of(fused), sigma_px, context), gsd, context);
  const double mean = sum / count;
  DetailFigures figures;
  figures.difference_rms_gsd = std::sqrt(std::max(squares / count - mean * mean, 0.0));
  figures.difference_bias_gsd = percentiles({fused.count(), difference, context}, gsd, {0.5})[0];
  figures.difference_detail_rms_gsd = of_change.rms;
  figures.difference_detail_mad_gsd = of_change.mad;
  figures.prior_detail_rms_gsd = of_prior.rms;
  figures.prior_detail_mad_gsd = of_prior.mad;
  figures.fused_detail_rms_gsd = of_fused.rms;
  figures.fused_detail_mad_gsd = of_fused.mad;
  figures.within_2_prior_sigma_fraction = share_within_prior(surface, prior, context);
  return figures;
}

PriorFigures provenance_of(const DepthPrior& prior, double gsd) {
  return {prior.points_total, prior.points_used,  prior.noise,           prior.noise / gsd,
          prior.spacing_px,   prior.smoothing_px, prior.filled_fraction, prior.hull_fraction};
}

PolarizationFigures measure_polarization(const AssessInput& input, const Context& context) {
  const PolarizationState& state = *input.polarization;
  constexpr std::array kinds{PixelState::valid, PixelState::saturated, PixelState::dark, PixelState::misfit};
  // Number of pixels of each kind, and of the object.
  const auto counts = sum_pixels<kinds.size() + 1>(state.valid.count(), context, [&](std::size_t i, auto& sums) {
    if (!is_object(input, i)) return;
    for (std::size_t k = 0; k < kinds.size(); ++k) sums[k] += state.valid[i] == static_cast<std::uint8_t>(kinds[k]);
    sums[kinds.size()] += 1;
  });
  /// Median and 95th percentile of the object's valid pixels.
  const auto middle_and_p95 = [&](const Image<float>& map) {
    const auto value = [&](std::size_t i) {
      const bool counts_in = is_object(input, i) && has_state(state.valid[i], PixelState::valid);
      return counts_in ? map[i] : no_value;
    };
    return percentiles({map.count(), value, context}, 1, {0.5, 0.95});
  };
  const std::vector<double> residuals = middle_and_p95(state.residual),
                            degrees_of_polarization = middle_and_p95(state.rho);
  PolarizationFigures figures;
  figures.valid_fraction = fraction_of(counts[0], counts.back());
  figures.saturated_fraction = fraction_of(counts[1], counts.back());
  figures.dark_fraction = fraction_of(counts[2], counts.back());
  figures.misfit_fraction = fraction_of(counts[3], counts.back());
  figures.residual_median = residuals[0];
  figures.residual_p95 = residuals[1];
  figures.degree_median = degrees_of_polarization[0];
  figures.degree_p95 = degrees_of_polarization[1];
  for (const double angle : state.angles_rad) figures.angles_deg.push_back(to_degrees(angle));
  figures.exposures = state.exposures;
  return figures;
}

HeightFigures describe_height(const HeightMap& height) {
  HeightFigures figures{
      height.status, height.perspective, height.residual_rms, static_cast<double>(height.unknowns), {}, no_value};
  std::copy(height.light.begin(), height.light.end(), figures.light.begin());
  const Eigen::Vector3d light = height.light.head<3>();
  // The camera is at −z from the surface.
  if (light.norm() > 0)
    figures.light_to_view_deg = to_degrees(std::acos(std::clamp(-light.normalized().z(), -1.0, 1.0)));
  return figures;
}

/// Patches and profiles that have no figures would otherwise just be missing in the report.
void warn_of_missing_sections(const Quality& quality, const Context& context) {
  for (const PatchFigures& patch : quality.patches) {
    if (patch.fused) continue;
    context.log(LogLevel::warning,
                "[[patch]] \"" + patch.name +
                    "\": ten pixels of the surface or fewer lie in its box, expected more: it has no "
                    "figures");
  }
  for (const ProfileFigures& profile : quality.profiles) {
    if (profile.status == ProfileStatus::done) continue;
    context.log(LogLevel::warning, "[[profile]] \"" + profile.name +
                                       "\": its line hardly meets the surface, expected one across it: it has no "
                                       "section");
  }
}

}  // namespace

double ground_sampling_distance(const Image<float>& depth, const Pinhole& camera, const Context& context) {
  std::vector<double> depths;
  const int center_u = depth.width() / 2, center_v = depth.height() / 2;
  const PixelRect center{center_u, center_v, center_u + 1, center_v + 1};
  for_each_pixel(center.grown(2, depth.size()), [&](int u, int v) {
    if (std::isfinite(depth(u, v))) depths.push_back(depth(u, v));
  });
  if (!depths.empty()) return percentile_in_place(depths, 0.5) / camera.focal();
  RankedValues all = rank_values(depth, context);
  if (all.size() == 0) throw data_error("the surface has no depth at all, so there is nothing to assess");
  return percentiles(std::move(all), 1, {0.5})[0] / camera.focal();
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
  quality.gsd = ground_sampling_distance(surface.depth, surface.camera, context);
  quality.registration_rms_px = input.registration_rms_px;

  context.progress("assess", 0, "coverage and detail");
  quality.coverage = measure_coverage(input, context);
  quality.sigma = measure_sigma(surface, quality.gsd, options.sigma_limit_gsd, context);
  if (input.polarization != nullptr) quality.polarization = measure_polarization(input, context);
  if (input.height != nullptr) quality.polarization_height = describe_height(*input.height);
  if (input.prior != nullptr) {
    quality.prior = provenance_of(*input.prior, quality.gsd);
    quality.prior_vs_fused = compare_with_prior(surface, *input.prior, quality.gsd, options, context);
  }

  context.progress("assess", 0.4, "patches and profiles");
  const bool in_sections = !(input.patches.empty() && input.profiles.empty());
  const Image<float> none;
  const Image<float>& prior = input.prior != nullptr ? input.prior->depth : none;
  const Image<float> polarization =
      input.height != nullptr && in_sections
          ? depth_from_height(*input.height, input.prior != nullptr ? prior : surface.depth, surface.camera, context)
          : Image<float>();
  const auto fit = [&](const Image<float>& depth, const PatchSpec& patch) {
    return depth.empty() ? std::nullopt : fit_patch(depth, surface.camera, patch, quality.gsd, options, context);
  };
  for (const PatchSpec& patch : input.patches) {
    quality.patches.push_back(
        {patch.name, patch.box, fit(prior, patch), fit(polarization, patch), fit(surface.depth, patch)});
  }
  for (const ProfileSpec& profile : input.profiles) {
    quality.profiles.push_back(
        section(profile, prior, polarization, surface.depth, surface.camera, quality.gsd, options, context));
  }
  warn_of_missing_sections(quality, context);
  quality.confidence = assessed_confidence(input, context);
  if (input.reference != nullptr) {
    context.progress("assess", 0.6, "comparing with the reference");
    quality.reference = compare_with_reference(surface, *input.reference, quality.gsd, options, context);
  }
  context.progress("assess", 1);
  return quality;
}

}  // namespace malus
