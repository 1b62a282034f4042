#include <algorithm>
#include <array>
#include <complex>
#include <memory>
#include <vector>

#include "malus/core/even_choice_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/fusion/finishes_internal.h"
#include "malus/fusion/surface_evidence_internal.h"
#include "malus/fusion/surroundings_course_internal.h"

namespace malus {
namespace {

constexpr std::array any_roughness{0.04, 0.08, 0.12, 0.2, 0.3, 0.42};
constexpr double near = 1.25;  // factor between tried values of a roughness that is approximately known
constexpr std::size_t enough_samples = 12000;

std::shared_ptr<const MirroredLightTable> tabulated(const Surroundings& surroundings, double roughness,
                                                    const RefinementImage& image, const MapCourse& course,
                                                    const Context& context) {
  Surroundings seen = surroundings;
  seen.finishes.usual = roughness;
  return std::make_shared<MirroredLightTable>(seen, course.material.index, image.camera, context);
}

/// The known finishes, and variants with one of the two a little smoother or rougher.
std::vector<Finishes> finishes_near(const Finishes& known) {
  std::vector<Finishes> tried{known};
  for (const double factor : {1 / near, near}) {
    tried.push_back({factor * known.usual, known.other});
    if (known.other > 0) tried.push_back({known.usual, factor * known.other});
  }
  return tried;
}

/// Samples that the map is fitted to. With two finishes, first decides which pixels have the other one.
std::vector<ReflectionSample> samples_of_map(RefinementImage& image, bool two_finishes, const MapCourse& course,
                                             const Context& context) {
  Image<double> refined;
  if (course.slow_px > 0) {
    refined = image.x;
    anchor_to_prior(image, course.x_prior, course.slow_px, context);
  }
  if (two_finishes) image.other_finish = pixels_of_other_finish(image, context);
  std::vector<ReflectionSample> samples = collect_samples(image, Reflection::diffuse, enough_samples);
  if (!refined.empty()) image.x = std::move(refined);
  return samples;
}

/// Finds the pixels of the other finish with these surroundings, and fits the surroundings again with each of the tried
/// finishes. Returns nothing if hardly any pixel has the other finish.
std::optional<SurroundingsFit> fit_both(const Surroundings& surroundings, const std::vector<Finishes>& tried,
                                        RefinementImage& image, const MapCourse& course, const Context& context) {
  constexpr double least_share = 0.01;
  image.reflection.mirrored = tabulated(surroundings, tried.front().usual, image, course, context);
  image.reflection.mirrored_by_other = tabulated(surroundings, tried.front().other, image, course, context);
  image.other_finish = pixels_of_other_finish(image, context);
  if (share_within(image.other_finish, image.usable) < least_share) return std::nullopt;
  return fit_surroundings(collect_samples(image, Reflection::diffuse, enough_samples), course.material, tried,
                          surroundings.radiance, context);
}

}  // namespace

void take_surroundings(const SurroundingsFit& fit, RefinementImage& image, RefineReport& report, MapCourse& course,
                       const Context& context) {
  constexpr double least_error = 0.05;
  report.surroundings = fit.surroundings;
  MirrorMaterial& material = course.material;
  if (material.is_metal()) {
    material.intensity_error = std::max(least_error, deviation_per_median * fit.intensity_error);
    image.reflection.metal_error = material.intensity_error;
    report.metal_index = material.index;
  }
  const Surroundings& found = report.surroundings;
  const auto& [usual, other] = found.finishes;
  image.reflection.mirrored = tabulated(found, usual, image, course, context);
  image.reflection.mirrored_by_other = other > 0 ? tabulated(found, other, image, course, context) : nullptr;
  report.other_finish_share = other > 0 ? share_within(image.other_finish, image.usable) : 0;
}

SurroundingsFit fit_mirrored(RefinementImage& image, RefineReport& report, MapCourse& course, const Context& context) {
  constexpr int rounds_between = 3;
  const Finishes known = report.surroundings.finishes;
  std::vector<Finishes> tried;
  if (report.surroundings.radiance.empty()) {
    for (const double roughness : any_roughness) tried.push_back({roughness});
  } else {
    tried = finishes_near(known);
    if (course.rounds_to_keep > 0) tried.resize(1);
  }
  const SurroundingsFit fit = fit_surroundings(samples_of_map(image, known.other > 0, course, context), course.material,
                                               tried, report.surroundings.radiance, context);
  if (tried.size() == 1) {
    --course.rounds_to_keep;
  } else if (fit.surroundings.finishes == known) {
    course.rounds_to_keep = rounds_between;
  }
  take_surroundings(fit, image, report, course, context);
  return fit;
}

SurroundingsFit fit_of_material(const std::vector<ReflectionSample>& samples, std::complex<double> index,
                                const Context& context) {
  static constexpr std::array<Finishes, 3> roughnesses{{{0.08}, {0.15}, {0.3}}};
  return fit_surroundings(samples, {index}, roughnesses, {}, context);
}

std::optional<std::pair<MirrorMaterial, SurroundingsFit>> find_metal(const std::vector<ReflectionSample>& samples,
                                                                     double dielectric_cost, const Context& context) {
  // Silver and gold, alloys of copper, iron and lead; at 550 nm.
  static constexpr std::array<std::complex<double>, 3> metals{{{0.1, 3.6}, {0.63, 3.19}, {2.5, 3.0}}};
  // At the prior's slopes the error of s0 was 0.03 to 0.11 for metals, and 0.27 to 0.9 for clay, glaze, paint and
  // stone.
  constexpr double largest_error = 0.15, cost_margin = 0.1;
  std::optional<std::pair<MirrorMaterial, SurroundingsFit>> best;
  for (const std::complex<double> index : metals) {
    SurroundingsFit fit = fit_of_material(samples, index, context);
    if (fit.intensity_error > largest_error || fit.cost > dielectric_cost + cost_margin) continue;
    if (!best || fit.cost < best->second.cost) best.emplace(MirrorMaterial{index}, std::move(fit));
  }
  return best;
}

void find_other_finish(const SurroundingsFit& one, RefinementImage& image, RefineReport& report, MapCourse& course,
                       const Context& context) {
  constexpr double least_ratio = 1.9, worthwhile = 0.05;
  constexpr int more_rounds = 2;
  const Surroundings& alone = one.surroundings;
  const double usual = alone.finishes.usual;
  std::optional<SurroundingsFit> both;
  for (const double other : any_roughness) {
    if (std::max(other / usual, usual / other) < least_ratio) continue;
    const auto fit = fit_both(alone, {{usual, other}}, image, course, context);
    if (fit && (!both || fit->cost < both->cost)) both = fit;
  }
  for (int i = 0; i < more_rounds && both; ++i)
    both = fit_both(both->surroundings, finishes_near(both->surroundings.finishes), image, course, context);
  const bool better = both && both->cost < one.cost - worthwhile;
  if (!better) image.other_finish = {};
  take_surroundings(better ? *both : one, image, report, course, context);
}

}  // namespace malus
