#include <algorithm>
#include <cmath>

#include "malus/core/even_choice_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/fusion/anchor_internal.h"
#include "malus/fusion/blended_slopes_internal.h"
#include "malus/fusion/evidence_weighing_internal.h"
#include "malus/fusion/gain_by_scale_internal.h"
#include "malus/fusion/refinement_verdict_internal.h"
#include "malus/fusion/reflection_labels_internal.h"
#include "malus/fusion/slow_waves_internal.h"

namespace malus {
namespace {

/// Trust by the share that the model explains at the result: if much of the polarization is left over, although the
/// slopes were fitted to it, the model does not hold.
double trust_of_result(double after) {
  constexpr double least = 0.3, enough = 0.8;
  return ramp(after, least, enough);
}

/// Share that the model explains at the prior's slopes: here, or over the whole object if that is more. The prior's
/// slopes are worst where there is most to gain, and there is one model for the whole object, so that its success
/// elsewhere is evidence for it here. This evidence counts fully from a share of `enough` here on, and not at all below
/// `least`, where the prior's slopes contradict the model.
double explained_here_or_elsewhere(double here, double over_all, double least, double enough) {
  return here + std::max(over_all - here, 0.0) * ramp(here, least, enough);
}

/// Share of the refined surface in the result, by the shares that are explained at the prior's slopes, here and over
/// the whole object, and at the result. Where the polarization is turned by 0.4 rad in a part of the object, the share
/// explained at the prior's slopes is still 0.2.
double trust_with_regions(double at_prior, double over_all, double after, const RefineOptions& options) {
  constexpr double least = 0.15, enough = 0.3;
  const auto trust = [&](double share) { return ramp(share, options.explained_least, options.explained_enough); };
  const double with_all = explained_here_or_elsewhere(at_prior, over_all, least, enough);
  return std::max(trust(at_prior), std::min(trust(with_all), trust_of_result(after)));
}

/// The same with a map of the surroundings, for which the shares at the prior's slopes are those explained beyond a
/// plane. Such a share is zero where the prior lacks the detail.
double trust_with_map(double at_prior, double over_all, double after) {
  constexpr double least = -0.3, enough = 0, nothing = 0.1, something = 0.3;
  return std::min(ramp(explained_here_or_elsewhere(at_prior, over_all, least, enough), nothing, something),
                  trust_of_result(after));
}

/// Share of the object within two of the prior's standard deviations of the prior.
double within_prior_errors(const RefinementImage& image, const Image<double>& x_prior) {
  return mean_over(image.object, [&](int u, int v) {
    return std::abs(image.x(u, v) - x_prior(u, v)) <= 2 * image.source(u, v).prior_sigma;
  });
}

/// Trust in a metal's surface, per cell, from the share that its map explains at the result. A metal's slopes follow
/// mainly from s0. The polarization, which is weak and noisy, is independent evidence: nearly everywhere it must fit
/// better at the surface than at the prior's. On a coin where it did so in only two thirds, the whole surface was worse
/// than the prior. A surface that is better than the prior differs from it by the prior's errors: 95 % are below two
/// standard deviations. In tests with three metals it was 85 % for the one whose light the map did not explain, and
/// 99 % for the others.
Image<float> trust_in_metal(const Refinement& refinement, const Image<float>& after, const Image<double>& x_prior) {
  constexpr double least = 0.05, enough = 0.2, doubtful = 0.75, nearly_all = 0.9;
  constexpr double too_far = 0.9, within = 0.95;
  const Image<float> before = refinement.explained_by_result(true);
  Image<float> trust(after.size());
  for (std::size_t i = 0; i < trust.count(); ++i) {
    const double gained = (after[i] - before[i]) / std::max(1.0 - before[i], 1e-6);
    trust[i] = static_cast<float>(ramp(gained, least, enough));
  }
  const double all = ramp(refinement.mean_over_object(trust), doubtful, nearly_all) *
                     ramp(within_prior_errors(refinement.image, x_prior), too_far, within);
  for (float& value : trust) value *= static_cast<float>(all);
  return trust;
}

/// Reduces the movement from the prior to the part that is gain. Returns the gain of all scales together.
GainByScale::Gains::Scale reduce_to_gain(Refinement& refinement, const Image<double>& x_prior) {
  RefinementImage& image = refinement.image;
  GainByScale gain(image.size(), image.reflection.metal_error > 0, image.noise_share);
  refinement.add_strips(false, gain);
  GainByScale::Gains gains = gain.gains(refinement.context);
  const Image<float> movement = movement_that_is_gain(image, x_prior, gains, refinement.context);
  for (std::size_t i = 0; i < movement.count(); ++i) {
    if (image.object[i]) image.x[i] = x_prior[i] + movement[i];
  }
  refinement.report.gain_share = refinement.mean_over_object(gains.all.gain);
  return gains.all;
}

/// Where less than half of the movement is gain, hardly anything remains of the refined surface.
double trust_of_gain(double gain) {
  constexpr double least = 0.5, enough = 0.75;
  return ramp(gain, least, enough);
}

/// How far the object's shape tells the surface from the light, 0 … 1. Waves that are longer than the distance between
/// places of the same normal can be exchanged for other light (distance_of_same_normals). The prior must know these
/// waves, or else nothing tells them from other light. A black mirror and bare metal have models that tell them: the
/// polarization follows from the slopes whatever is mirrored, and the slopes from the brightness.
double trust_of_shape(const DepthPrior& prior, const Refinement& refinement) {
  constexpr double least = waves_of_prior, enough = 2;
  const RefinementImage& image = refinement.image;
  if (prior.smoothing_px <= 0 || image.reflection.metal_error > 0 || is_mostly_specular(image)) return 1;
  return ramp(refinement.same_normals_px / prior.smoothing_px, least, enough);
}

/// Returns the surface to the prior where it is farther from the prior than the prior's errors allow, for example where
/// the search for other minima took a wrong one. A surface that is better than its prior differs from it by the prior's
/// errors: by one standard deviation, if this contains all errors, as a stated one of a mesh or a depth map does (with
/// a margin, because errors are larger in some places). That of a cloud does not contain the detail that its smoothing
/// removed, and its errors can be twice as large as stated, above all at silhouettes.
void stay_near_prior(const DepthPrior& prior, Refinement& refinement, const Image<double>& x_prior) {
  constexpr double allowed = 3, too_far = 5, allowed_of_all = 1.5, too_far_of_all = 2.5;
  const bool has_all_errors = prior.smoothing_px == 0;
  const double least = has_all_errors ? allowed_of_all : allowed, most = has_all_errors ? too_far_of_all : too_far;
  RefinementImage& image = refinement.image;
  Image<std::uint8_t>& trust = refinement.report.trust;
  const Image<float> deviations = deviations_from_prior(image, x_prior, refinement.context);
  parallel_pixels(refinement.context, image.object, [&](int u, int v) {
    const double deviation = between_cells(deviations, ExplainedPolarization::cell_px, u, v);
    const double kept = 1 - ramp(deviation, least, most);
    image.x(u, v) = x_prior(u, v) + kept * (image.x(u, v) - x_prior(u, v));
    trust(u, v) = static_cast<std::uint8_t>(std::lround(kept * trust(u, v)));
  });
}

}  // namespace

void weigh_evidence(const DepthPrior& prior, Refinement& refinement) {
  const RefineOptions& options = refinement.options;
  if (!options.evidence) return;
  RefinementImage& image = refinement.image;
  RefineReport& report = refinement.report;
  const Context& context = refinement.context;
  report.trust = Image<std::uint8_t>(image.size());
  const Image<double> x_prior = image.prior_surface(context);
  const ExplainedPolarization at_prior = refinement.explained();
  const Image<float> beyond_plane = at_prior.shares(true, context);
  const bool with_map = image.reflection.mirrored != nullptr, explained_as_metal = image.reflection.metal_error > 0;
  const Image<float> shares = with_map ? beyond_plane : at_prior.shares(false, context);
  const Image<float> after = refinement.explained_by_result(false);
  report.explained_share = refinement.mean_over_object(shares);
  const Image<float> in_metal = explained_as_metal ? trust_in_metal(refinement, after, x_prior) : Image<float>();
  // The slopes from a dielectric's formulas are wrong for a metal, however well they fit.
  const bool is_metal = looks_like_metal(image), settled = has_settled(report);
  const GainByScale::Gains::Scale gain = reduce_to_gain(refinement, x_prior);
  report.shape_share = trust_of_shape(prior, refinement);
  // A plane or ball that stands for the object says nothing about single depths.
  const bool is_shape = prior.smoothing_px <= 0 && prior.noise <= 0;
  Image<float> trusts(image.size());
  parallel_pixels(context, image.object, [&](int u, int v) {
    const auto share = [&](const Image<float>& cells) {
      return between_cells(cells, ExplainedPolarization::cell_px, u, v);
    };
    const double explained = explained_as_metal ? share(in_metal)
                             : with_map
                                 ? trust_with_map(share(shares), report.explained_share, share(after))
                                 : trust_with_regions(share(shares), report.explained_share, share(after), options);
    const double trust = is_metal || !settled ? 0 : report.shape_share * explained;
    const double gained = trust_of_gain(between_cells(gain.gain, gain.cell_px, u, v));
    if (image.pixels(u, v)) report.trust(u, v) = static_cast<std::uint8_t>(std::lround(255 * trust * gained));
    trusts(u, v) = static_cast<float>(trust);
    if (!is_shape) image.x(u, v) = x_prior(u, v) + trust * (image.x(u, v) - x_prior(u, v));
  });
  if (is_shape) blend_slopes(image, x_prior, trusts, context);
  anchor_to_prior(image, x_prior, std::min(anchor_length_px(prior, image, options.anchor), refinement.longest_wave_px),
                  context);
  // Assumed standard deviations are no evidence, and the errors of shapes and hulls are systematic.
  const bool is_stated = prior.noise > 0 && !prior.assumes_sigma && prior.hull_fraction <= 0.5;
  if (prior.smoothing_px > 0 || is_stated) stay_near_prior(prior, refinement, x_prior);
  if (prior.smoothing_px > 0) shrink_slow_waves(image, x_prior, prior.smoothing_px, context);
  // Pixels without usable polarization follow their neighbors, and are not counted as evidence.
  report.trusted_share = mean_over(image.usable, [&](int u, int v) { return report.trust(u, v) / 255.0; });
  report.explained_beyond_plane = refinement.mean_over_object(beyond_plane);
}

}  // namespace malus
