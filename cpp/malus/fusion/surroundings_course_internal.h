#pragma once

#include <optional>
#include <utility>

#include "malus/core/context.h"
#include "malus/fusion/refine_internal.h"
#include "malus/fusion/refinement_image_internal.h"
#include "malus/fusion/surroundings_fit_internal.h"

namespace malus {

/// How the map of the surroundings is fitted next.
struct MapCourse {
  MirrorMaterial material;
  int rounds_to_keep = 0;  ///< for which its roughness is not asked again

  /// A map and a surface that bends slowly explain each other wherever each normal is in one place only, as on a bowl:
  /// the map turns by what the surface does. So it is fitted at a surface that has the prior's low frequencies.
  double slow_px = 0;       ///< longer waves than this Gaussian's are the prior's; 0 = at the surface as it is
  Image<double> x_prior{};  ///< the prior at the nodes
};

/// Takes over a fit of the surroundings, and of a metal how well it predicts s0.
void take_surroundings(const SurroundingsFit& fit, RefinementImage& image, RefineReport& report, MapCourse& course,
                       const Context& context);

/// Fits the surroundings at the current surface (its low frequencies as the course says) and takes them over: near the
/// roughness that is known, if it is, and after telling anew which pixels have the other finish, if there is one.
SurroundingsFit fit_mirrored(RefinementImage& image, RefineReport& report, MapCourse& course, const Context& context);

/// The metal that explains the polarization and the light of the pixels best, if any explains both.
std::optional<std::pair<MirrorMaterial, SurroundingsFit>> find_metal(const std::vector<ReflectionSample>& samples,
                                                                     double dielectric_cost, const Context& context);

/// Divides the object into two finishes, as of glaze and bare clay, where these explain clearly more than `one` does,
/// the fit of a single one.
void find_other_finish(const SurroundingsFit& one, RefinementImage& image, RefineReport& report, MapCourse& course,
                       const Context& context);

}  // namespace malus
