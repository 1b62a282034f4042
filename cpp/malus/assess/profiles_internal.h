#pragma once

#include <array>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/field_list.h"
#include "malus/core/image.h"
#include "malus/io/station_spec.h"
#include "malus/options/surface_options.h"

namespace malus {

/// Difference of two surfaces along a profile, in GSD; NaN = there is no sample where both exist.
struct ProfileDifference {
  std::size_t count = 0;  ///< samples where both surfaces exist
  double mean_gsd = std::numeric_limits<double>::quiet_NaN();
  double rms_gsd = mean_gsd;  ///< about zero
  /// About the mean, so that the free constant of a polarization height has no effect.
  double rms_centered_gsd = mean_gsd;

  MALUS_FIELDS(count, mean_gsd, rms_gsd, rms_centered_gsd)
};

enum class ProfileStatus { not_run, done, too_few_samples };
constexpr auto names_of(ProfileStatus) {
  return std::to_array<std::string_view>({"not run", "done", "fewer than two samples on the surface"});
}

/// A section through the surfaces along a line of the image (Fig. 12, 13), with the meaningful part of Table 1.
///
/// Heights are perpendicular to the chord plane, positive towards the camera. The chord plane passes through the first
/// and last point of the fused surface on the line, and is turned about their chord to face the camera. Position and
/// height are then coordinates in the plane of the line's rays: the positions are those of the fused surface's points,
/// where it has none of the prior's, else where the rays meet the chord plane. Table 1's "photogrammetry RMSE" is the
/// quadratic complement of another row, without a reference behind it. The meaningful figures, given here, are the
/// differences between the surfaces and the roughness of each.
struct ProfileFigures {
  std::string name;
  std::array<double, 2> from_px{}, to_px{};
  ProfileStatus status = ProfileStatus::not_run;
  std::vector<double> position_px;                 ///< along the line in the image
  std::vector<double> position;                    ///< along the chord, station unit
  std::vector<double> prior, polarization, fused;  ///< heights, station unit, NaN = none; empty = no such surface
  ProfileDifference fused_minus_prior, polarization_minus_prior, fused_minus_polarization;
  /// RMS of the heights' high-pass (detail_sigma_px) along the line, GSD; NaN = no such surface.
  double roughness_prior_gsd = std::numeric_limits<double>::quiet_NaN();
  double roughness_polarization_gsd = roughness_prior_gsd, roughness_fused_gsd = roughness_prior_gsd;

  MALUS_FIELDS(name, from_px, to_px, status, position_px, position, prior, polarization, fused, fused_minus_prior,
               polarization_minus_prior, fused_minus_polarization, roughness_prior_gsd, roughness_polarization_gsd,
               roughness_fused_gsd)
};

/// Bilinear value of a one-channel raster at (u, v); NaN outside or if a pixel with non-zero weight is NaN.
double sample_bilinear(const Image<float>& image, double u, double v);

/// Section along [[profile]]. `fused`, which defines the chord, must not be empty; the other depth maps may. Samples
/// are at most profile_step_px apart, ends included. Throws an input error if the line leaves the image or has no
/// length.
ProfileFigures section(const ProfileSpec& profile, const Image<float>& prior, const Image<float>& polarization,
                       const Image<float>& fused, const Pinhole& camera, double gsd, const AssessOptions& options,
                       const Context& context);

}  // namespace malus
