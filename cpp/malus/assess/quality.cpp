#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <utility>

#include "malus/assess/high_pass_internal.h"
#include "malus/assess/polarization_depth_internal.h"
#include "malus/assess/quality_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/percent_internal.h"
#include "malus/core/ranked_values_internal.h"
#include "malus/core/robust_spread_internal.h"

namespace malus {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double degrees = 180 / std::numbers::pi;

constexpr std::size_t grain = 1 << 16;

RankedValues rank_values(const Image<float>& image, const Context& context) {
  const auto values = [&image](std::size_t begin, std::size_t end, float* to) {
    std::copy(image.data() + begin, image.data() + end, to);
  };
  return {image.count(), values, context};
}

/// Figures of some pixels that are added up.
template <std::size_t n>
struct Sums : std::array<double, n> {
  Sums& operator+=(const Sums& other) {
    for (std::size_t i = 0; i < n; ++i) (*this)[i] += other[i];
    return *this;
  }
};

/// Sums over all pixels of what add(pixel, sums) adds for each.
template <std::size_t n, class Add>
std::array<double, n> sum_pixels(std::size_t count, const Context& context, Add&& add) {
  return parallel_sum(context, count, grain, Sums<n>{}, [&](std::size_t begin, std::size_t end) {
    Sums<n> part{};
    for (std::size_t i = begin; i < end; ++i) add(i, part);
    return part;
  });
}

double fraction_of(double part, double whole) {
  return whole > 0 ? part / whole : nan;
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
  const auto sizes = [&detail](std::size_t begin, std::size_t end, float* to) {
    std::transform(detail.data() + begin, detail.data() + end, to, [](float value) { return std::abs(value); });
  };
  const double median = percentiles({detail.count(), sizes, context}, gsd, {0.5})[0];
  return {count > 0 ? std::sqrt(squares / count) : nan, deviation_per_median * median};
}

DetailFigures compare_with_prior(const FusedSurface& surface, const DepthPrior& prior, double gsd,
                                 const AssessOptions& options, const Context& context) {
  const Image<float>&fused = surface.depth, &before = prior.depth;
  struct Index {
    enum : std::size_t { count, sum, squares, compared, within, size };
  };
  const auto sums = sum_pixels<Index::size>(fused.count(), context, [&](std::size_t i, Sums<Index::size>& part) {
    const float difference = fused[i] - before[i];
    if (!std::isfinite(difference)) return;
    const double value = difference / gsd;
    part[Index::count] += 1;
    part[Index::sum] += value;
    part[Index::squares] += value * value;
    if (prior.sigma.empty() || !std::isfinite(prior.sigma[i])) return;
    part[Index::compared] += 1;
    part[Index::within] += std::abs(difference) < 2 * prior.sigma[i];
  });
  const auto differences = [&](std::size_t begin, std::size_t end, float* to) {
    std::transform(fused.data() + begin, fused.data() + end, before.data() + begin, to, std::minus<>());
  };
  Image<float> change = Image<float>::uninitialized(fused.size());
  differences(0, fused.count(), change.data());
  // One raster of detail at a time.
  const double sigma_px = options.detail_sigma_px;
  const Spread of_change = detail_of(high_pass(std::move(change), sigma_px, context), gsd, context);
  const Spread of_prior = detail_of(high_pass(before, sigma_px, context), gsd, context);
  const Spread of_fused = detail_of(high_pass(fused, sigma_px, context), gsd, context);
  const double mean = sums[Index::sum] / sums[Index::count], square = sums[Index::squares] / sums[Index::count];
  DetailFigures figures;
  figures.difference_rms_gsd = std::sqrt(std::max(square - mean * mean, 0.0));
  figures.difference_bias_gsd = percentiles({fused.count(), differences, context}, gsd, {0.5})[0];
  figures.difference_detail_rms_gsd = of_change.rms;
  figures.difference_detail_mad_gsd = of_change.mad;
  figures.prior_detail_rms_gsd = of_prior.rms;
  figures.prior_detail_mad_gsd = of_prior.mad;
  figures.fused_detail_rms_gsd = of_fused.rms;
  figures.fused_detail_mad_gsd = of_fused.mad;
  figures.within_2_prior_sigma_fraction = fraction_of(sums[Index::within], sums[Index::compared]);
  return figures;
}

PriorFigures provenance_of(const DepthPrior& prior, double gsd) {
  return {prior.points_total, prior.points_used,  prior.noise,          prior.noise / gsd,
          prior.spacing_px,   prior.smoothing_px, prior.filled_fraction};
}

PolarizationFigures measure_polarization(const AssessInput& input, const Context& context) {
  const PolarizationState& state = *input.polarization;
  constexpr std::array kinds{PixelState::valid, PixelState::saturated, PixelState::dark, PixelState::misfit};
  // Pixels of each kind, and of the object.
  const auto counts = sum_pixels<kinds.size() + 1>(state.valid.count(), context, [&](std::size_t i, auto& sums) {
    if (!is_object(input, i)) return;
    for (std::size_t k = 0; k < kinds.size(); ++k) sums[k] += state.valid[i] == static_cast<std::uint8_t>(kinds[k]);
    sums[kinds.size()] += 1;
  });
  /// Median and 95th percentile of the object's valid pixels.
  const auto middle_and_p95 = [&](const Image<float>& map) {
    const auto values = [&](std::size_t begin, std::size_t end, float* to) {
      for (std::size_t i = begin; i < end; ++i) {
        const bool counts_in = is_object(input, i) && state.valid[i] == static_cast<std::uint8_t>(PixelState::valid);
        to[i - begin] = counts_in ? map[i] : std::numeric_limits<float>::quiet_NaN();
      }
    };
    return percentiles({map.count(), values, context}, 1, {0.5, 0.95});
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

double ground_sampling_distance(const Image<float>& depth, const Pinhole& camera, const Context& context) {
  std::vector<double> depths;
  const int centre_u = depth.width() / 2, centre_v = depth.height() / 2;
  for (int v = centre_v - 2; v <= centre_v + 2; ++v) {
    for (int u = centre_u - 2; u <= centre_u + 2; ++u) {
      if (depth.contains(u, v) && std::isfinite(depth(u, v))) depths.push_back(depth(u, v));
    }
  }
  if (!depths.empty()) return percentile(std::move(depths), 0.5) / camera.focal();
  RankedValues all = rank_values(depth, context);
  if (all.size() == 0) throw data_error("the surface has no depth at all, so there is nothing to assess");
  return percentiles(std::move(all), 1, {0.5})[0] / camera.focal();
}

namespace {

// In what follows a figure that is missing or NaN proves nothing: comparisons are written so that it fails them.

/// A surface that is unsure by much has no detail that could be trusted.
void limit_by_sigma(const std::optional<SigmaFigures>& sigma, Confidence& confidence) {
  constexpr double unknown_gsd = 10;
  if (!sigma || std::isnan(sigma->median_gsd)) {
    confidence.limit(ConfidenceLevel::partial, "How unsure the surface is, is not known.");
  } else if (!(sigma->median_gsd <= unknown_gsd)) {
    confidence.limit(ConfidenceLevel::low, "The surface is unsure by " +
                                               std::to_string(std::lround(sigma->median_gsd)) +
                                               " times the ground sampling distance in the median.");
  }
}

/// Fused and prior surface contradict each other where they are farther apart than the prior is unsure.
void limit_by_distance(const std::optional<DetailFigures>& figures, Confidence& confidence) {
  // 0.95 are expected. Stations whose surface is right have 0.8 at least, those that went astray less than 0.45.
  constexpr double least_within = 0.6;
  const double within = figures ? figures->within_2_prior_sigma_fraction : nan;
  if (std::isnan(within)) {
    confidence.limit(ConfidenceLevel::partial, "Nothing tells how far the surface may lie from its prior.");
  } else if (!(within >= least_within)) {
    confidence.limit(ConfidenceLevel::low, "Only " + percent(within) +
                                               " of the surface lie within two standard deviations of the prior, 95 % "
                                               "are expected: prior and polarization contradict each other.");
  }
}

/// Between the prior's data the surface's low frequencies are an interpolation, however sure its detail is.
void limit_by_holes(const PriorFigures& prior, Confidence& confidence) {
  constexpr double many = 0.25, most = 0.7;
  if (prior.filled_fraction <= many) return;
  const std::string share = std::isnan(prior.filled_fraction) ? "an unknown part" : percent(prior.filled_fraction);
  confidence.limit(
      prior.filled_fraction > most ? ConfidenceLevel::low : ConfidenceLevel::partial,
      "On " + share + " of the object the prior has no data of its own: the surface is an interpolation there.");
}

/// Where polarization is not usable nothing is measured, and what is near goes on.
void limit_by_gaps(const PolarizationFigures& polarization, Confidence& confidence) {
  constexpr double nearly_all = 0.9;
  if (polarization.valid_fraction >= nearly_all) return;
  const std::string share =
      std::isnan(polarization.valid_fraction) ? "an unknown part" : percent(1 - polarization.valid_fraction);
  confidence.limit(ConfidenceLevel::partial, "On " + share +
                                                 " of the object the polarization is not usable (saturated, too dark, "
                                                 "or off the sinusoid): nothing finer than the prior is known there.");
}

/// What the figures add to what the fusion says of its own result.
Confidence confidence_of(const Quality& quality, Confidence confidence) {
  limit_by_sigma(quality.sigma, confidence);
  limit_by_distance(quality.prior_vs_fused, confidence);
  if (quality.prior) limit_by_holes(*quality.prior, confidence);
  if (quality.polarization) limit_by_gaps(*quality.polarization, confidence);
  return confidence;
}

}  // namespace

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
  quality.confidence = confidence_of(quality, surface.confidence);
  if (input.reference != nullptr) {
    context.progress("assess", 0.6, "comparing with the reference");
    quality.reference = compare_with_reference(surface, *input.reference, quality.gsd, options, context);
  }
  context.progress("assess", 1);
  return quality;
}

}  // namespace malus
