#pragma once

#include <complex>
#include <optional>
#include <utility>
#include <vector>

#include "malus/core/context.h"
#include "malus/fusion/refine_internal.h"
#include "malus/fusion/refinement_image_internal.h"
#include "malus/fusion/surroundings_fit_internal.h"

namespace malus {

/// State of the fits of the map of the surroundings from round to round.
struct MapCourse {
  MirrorMaterial material;
  int rounds_to_keep = 0;  ///< rounds left in which the roughness stays fixed

  /// Where each normal occurs in one place only, as on a bowl, a slow bend of the surface looks like a turned map. The
  /// map is therefore fitted at a surface that has the prior's low frequencies.
  double slow_px = 0;       ///< waves longer than this Gaussian are the prior's; 0 = fit at the current surface
  Image<double> x_prior{};  ///< the prior at the nodes
};

/// Stores a fit of the surroundings in image and report, and for a metal how well the fit predicts s0.
void take_surroundings(const SurroundingsFit& fit, RefinementImage& image, RefineReport& report, MapCourse& course,
                       const Context& context);

/// Fits the surroundings at the current surface (with the low frequencies that `course` asks for) and stores them.
/// Tries roughnesses near the known one, if any, and first decides again which pixels have the other finish, if there
/// is one.
SurroundingsFit fit_mirrored(RefinementImage& image, RefineReport& report, MapCourse& course, const Context& context);

/// The surroundings that a material of this refractive index mirrors, fitted with a few roughnesses. An index with an
/// imaginary part is a metal's.
SurroundingsFit fit_of_material(const std::vector<ReflectionSample>& samples, std::complex<double> index,
                                const Context& context);

/// The metal that best explains both polarization and s0 of the samples; none if no metal explains both.
std::optional<std::pair<MirrorMaterial, SurroundingsFit>> find_metal(const std::vector<ReflectionSample>& samples,
                                                                     double dielectric_cost, const Context& context);

/// Divides the object into two finishes, such as glaze and bare clay, if two explain clearly more than `one`, the fit
/// with a single finish. Stores the better fit.
void find_other_finish(const SurroundingsFit& one, RefinementImage& image, RefineReport& report, MapCourse& course,
                       const Context& context);

}  // namespace malus
