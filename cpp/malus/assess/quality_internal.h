#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "malus/assess/comparison_internal.h"
#include "malus/assess/patches_internal.h"
#include "malus/assess/profiles_internal.h"
#include "malus/core/confidence.h"
#include "malus/core/field_list.h"
#include "malus/fusion/fused_surface.h"
#include "malus/height/height_map.h"
#include "malus/io/station_spec.h"
#include "malus/polarization/polarization_state.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// How much of the object has a depth.
struct CoverageFigures {
  double object_pixels = 0;
  double depth_pixels = 0;  ///< object pixels with a fused depth
  double fraction = 0;
  double prior_fraction = 0;  ///< the same for the prior; 0 without a prior

  MALUS_FIELDS(object_pixels, depth_pixels, fraction, prior_fraction)
};

/// What fusion changed, measured without a reference. "Detail" is depth, less the plane that fits the fused one, minus
/// its Gaussian mean (detail_sigma_px); RMS and MAD (1.4826 × median of the absolute value), in GSD. More detail is
/// more relief or more noise: the patches show which.
struct DetailFigures {
  double difference_rms_gsd = 0;   ///< fused − prior, mean removed
  double difference_bias_gsd = 0;  ///< median of fused − prior
  double difference_detail_rms_gsd = 0, difference_detail_mad_gsd = 0;
  double prior_detail_rms_gsd = 0, prior_detail_mad_gsd = 0;
  double fused_detail_rms_gsd = 0, fused_detail_mad_gsd = 0;
  double within_2_prior_sigma_fraction = 0;  ///< |fused − prior| < 2 · prior sigma; NaN without prior sigma

  MALUS_FIELDS(difference_rms_gsd, difference_bias_gsd, difference_detail_rms_gsd, difference_detail_mad_gsd,
               prior_detail_rms_gsd, prior_detail_mad_gsd, fused_detail_rms_gsd, fused_detail_mad_gsd,
               within_2_prior_sigma_fraction)
};

/// The surface's own standard deviations.
struct SigmaFigures {
  double median_gsd = 0, p95_gsd = 0;
  double limit_gsd = 0;  ///< AssessOptions::sigma_limit_gsd
  double below_limit_fraction = 0;
  double above_limit_fraction = 0;

  MALUS_FIELDS(median_gsd, p95_gsd, limit_gsd, below_limit_fraction, above_limit_fraction)
};

/// The sinusoid fit. Shares are of the object's pixels.
struct PolarizationFigures {
  double valid_fraction = 0, saturated_fraction = 0, dark_fraction = 0, misfit_fraction = 0;
  double residual_median = 0, residual_p95 = 0;  ///< in expected standard deviations, of valid pixels; ~1 = noise only
  double degree_median = 0, degree_p95 = 0;      ///< of valid pixels
  std::vector<double> angles_deg;
  std::vector<int> exposures;

  MALUS_FIELDS(valid_fraction, saturated_fraction, dark_fraction, misfit_fraction, residual_median, residual_p95,
               degree_median, degree_p95, angles_deg, exposures)
};

/// The polarization height and its light: s0-shading = light · (normal, 1), camera frame.
struct HeightFigures {
  HeightStatus status = HeightStatus::not_run;
  bool perspective = true;
  double residual_rms = 0;
  double unknowns = 0;
  std::array<double, 4> light{};
  double light_to_view_deg =
      0;  ///< angle between light and the direction back along the optical axis; NaN without light

  MALUS_FIELDS(status, perspective, residual_rms, unknowns, light, light_to_view_deg)
};

/// Origin of the prior (DepthPrior), lengths in station unit.
struct PriorFigures {
  double points_total = 0, points_used = 0;
  double noise = 0, noise_gsd = 0;
  double spacing_px = 0, smoothing_px = 0, filled_fraction = 0, hull_fraction = 0;

  MALUS_FIELDS(points_total, points_used, noise, noise_gsd, spacing_px, smoothing_px, filled_fraction, hull_fraction)
};

/// Every figure of the report. Lengths without a suffix are in `unit`; NaN = could not be measured; an empty optional =
/// the step was not run or its input is missing.
struct Quality {
  FusionStatus status = FusionStatus::not_run;  ///< of the fused surface
  Confidence confidence;                        ///< from evidence, independent of the solver's status
  std::optional<Fusion> method;
  std::vector<std::string> warnings;
  std::string unit;
  int width = 0, height = 0;
  double gsd = 0;  ///< depth / focal length, see ground_sampling_distance
  CoverageFigures coverage;
  std::optional<SigmaFigures> sigma;
  std::optional<DetailFigures> prior_vs_fused;
  std::optional<PriorFigures> prior;
  std::optional<PolarizationFigures> polarization;
  std::optional<HeightFigures> polarization_height;
  std::vector<double> registration_rms_px;
  std::vector<PatchFigures> patches;
  std::vector<ProfileFigures> profiles;
  std::optional<ReferenceComparison> reference;

  MALUS_FIELDS(status, confidence, method, warnings, unit, width, height, gsd, coverage, sigma, prior_vs_fused, prior,
               polarization, polarization_height, registration_rms_px, patches, profiles, reference)
};

/// Input of the assessment. Only `surface` is required; null = not available. All rasters have the surface's size.
struct AssessInput {
  const FusedSurface* surface = nullptr;
  const DepthPrior* prior = nullptr;
  const HeightMap* height = nullptr;
  const PolarizationState* polarization = nullptr;
  const TriangleMesh* reference = nullptr;  ///< world frame; a cloud if it has no triangles
  std::vector<double> registration_rms_px;
  std::vector<PatchSpec> patches;
  std::vector<ProfileSpec> profiles;
  std::string unit = "mm";
};

/// Depth / focal length, with the depth at the image center (median of the 5 × 5 pixels around it), or with the map's
/// median depth if the center is empty. Throws a data error if there is no depth at all.
double ground_sampling_distance(const Image<float>& depth, const Pinhole& camera, const Context& context = {});

/// Computes every figure that the input allows. Throws an input error for a patch or profile outside of the image or
/// rasters of another size, a data error for a surface without depth or a reference that cannot be used.
Quality assess(const AssessInput& input, const AssessOptions& options, const Context& context);

}  // namespace malus
