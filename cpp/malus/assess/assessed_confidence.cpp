#include <cmath>
#include <limits>
#include <string>

#include "malus/assess/assessed_confidence_internal.h"
#include "malus/assess/statistics_internal.h"
#include "malus/core/digits_internal.h"
#include "malus/core/pixel_sums_internal.h"
#include "malus/core/ranked_values_internal.h"

namespace malus {
namespace {

// A figure that is missing or NaN proves nothing: the comparisons below are written so that NaN fails them.

void limit_by_sigma(const FusedSurface& surface, Confidence& confidence, const Context& context) {
  const auto sigma = [&](std::size_t i) { return surface.sigma[i]; };
  const double median_gsd = percentiles({surface.sigma.count(), sigma, context}, 1, {0.5})[0] /
                            ground_sampling_distance(surface.depth, surface.camera, context);
  if (std::isnan(median_gsd)) {
    confidence.limit(ConfidenceLevel::partial, "The surface's standard deviation is not known.");
    return;
  }
  limit_by_sigma_gsd(median_gsd, confidence);
}

/// Fused and prior surface contradict each other where their distance exceeds the prior's uncertainty.
void limit_by_distance(const FusedSurface& surface, const DepthPrior* prior, Confidence& confidence,
                       const Context& context) {
  // 0.95 is expected. Stations with a correct surface have at least 0.8, those with a wrong surface less than 0.45.
  constexpr double least_within = 0.6;
  const double within = prior ? share_within_prior(surface, *prior, context) : std::numeric_limits<double>::quiet_NaN();
  if (std::isnan(within)) {
    confidence.limit(ConfidenceLevel::partial, "Nothing tells how far the surface may lie from its prior.");
  } else if (!(within >= least_within)) {
    confidence.limit(ConfidenceLevel::low, "Only " + percent(within) +
                                               " of the surface lie within two standard deviations of the prior, 95 % "
                                               "are expected: prior and polarization contradict each other.");
  }
}

/// In the prior's holes the surface's low frequencies are an interpolation, however reliable its detail is.
void limit_by_holes(const DepthPrior& prior, Confidence& confidence) {
  constexpr double many = 0.25, most = 0.7;
  if (prior.filled_fraction <= many) return;
  const std::string share = std::isnan(prior.filled_fraction) ? "an unknown part" : percent(prior.filled_fraction);
  confidence.limit(
      prior.filled_fraction > most ? ConfidenceLevel::low : ConfidenceLevel::partial,
      "On " + share + " of the object the prior has no data of its own: the surface is an interpolation there.");
}

/// A visual hull shows no hollows, however well its outlines are known.
void limit_by_hull(const DepthPrior& prior, Confidence& confidence) {
  constexpr double many = 0.25;
  if (!(prior.hull_fraction > many)) return;
  confidence.limit(ConfidenceLevel::partial, "On " + percent(prior.hull_fraction) +
                                                 " of the object the prior is the photos' visual hull, which the "
                                                 "outlines give: it shows no hollows.");
}

/// Whether the surface leaves the prior farther than the prior's errors allow cannot be told without these errors.
void limit_by_assumed_sigma(const DepthPrior& prior, Confidence& confidence) {
  if (!prior.assumes_sigma) return;
  confidence.limit(ConfidenceLevel::partial,
                   "The standard deviation of the coarse surface is assumed, because it is not stated: if the surface "
                   "is more precise, fusion can make it worse. Give it as sigma in [prior].");
}

/// Where polarization is not usable nothing is measured, and the surface continues that of the neighborhood.
void limit_by_gaps(const AssessInput& input, Confidence& confidence, const Context& context) {
  constexpr double nearly_all = 0.9;
  const double usable = usable_share(input, context);
  if (usable >= nearly_all) return;
  const std::string share = std::isnan(usable) ? "an unknown part" : percent(1 - usable);
  confidence.limit(ConfidenceLevel::partial, "On " + share +
                                                 " of the object the polarization is not usable (saturated, too dark, "
                                                 "or off the sinusoid): nothing finer than the prior is known there.");
}

}  // namespace

bool is_object(const AssessInput& input, std::size_t pixel) {
  if (input.polarization != nullptr) {
    return !has_state(input.polarization->valid[pixel], PixelState::outside);
  }
  return std::isfinite(input.surface->depth[pixel]) ||
         (input.prior != nullptr && std::isfinite(input.prior->depth[pixel]));
}

double usable_share(const AssessInput& input, const Context& context) {
  const Mask& state = input.polarization->valid;
  const auto [valid, object] = sum_pixels<2>(state.count(), context, [&](std::size_t i, Sums<2>& sums) {
    if (!is_object(input, i)) return;
    sums[0] += has_state(state[i], PixelState::valid);
    sums[1] += 1;
  });
  return fraction_of(valid, object);
}

double share_within_prior(const FusedSurface& surface, const DepthPrior& prior, const Context& context) {
  if (prior.sigma.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto [within, compared] = sum_pixels<2>(surface.depth.count(), context, [&](std::size_t i, Sums<2>& sums) {
    const float difference = surface.depth[i] - prior.depth[i];
    if (!std::isfinite(difference) || !std::isfinite(prior.sigma[i])) return;
    sums[0] += std::abs(difference) < 2 * prior.sigma[i];
    sums[1] += 1;
  });
  return fraction_of(within, compared);
}

void limit_by_sigma_gsd(double sigma_gsd, Confidence& confidence) {
  constexpr double most_gsd = 10;
  if (sigma_gsd <= most_gsd) return;
  confidence.limit(ConfidenceLevel::low, "The standard deviation of the surface is " +
                                             std::to_string(std::lround(sigma_gsd)) +
                                             " times the ground sampling distance (median): too much for fine detail.");
}

Confidence assessed_confidence(const AssessInput& input, const Context& context) {
  Confidence confidence = input.surface->confidence;
  limit_by_sigma(*input.surface, confidence, context);
  limit_by_distance(*input.surface, input.prior, confidence, context);
  if (input.prior != nullptr) {
    limit_by_holes(*input.prior, confidence);
    limit_by_hull(*input.prior, confidence);
    limit_by_assumed_sigma(*input.prior, confidence);
  }
  if (input.polarization != nullptr) limit_by_gaps(input, confidence, context);
  return confidence;
}

}  // namespace malus
