#include <algorithm>
#include <cmath>
#include <string>

#include "malus/core/digits_internal.h"
#include "malus/fusion/refinement_verdict_internal.h"

namespace malus {
namespace {

bool is_the_prior(const RefineReport& report) {
  return report.trusted_share < refined_nowhere;
}

/// A warning that lowers the confidence.
void warn(ConfidenceLevel most, const std::string& text, FusedSurface& surface) {
  surface.warnings.push_back(text);
  surface.confidence.limit(most, text);
}

/// RMS change of depth in a round, in the station's GSD.
double change_of(const RefineIteration& round) {
  return round.change_gsd * round.binning;
}

bool is_settled(const RefineIteration& round) {
  constexpr double settled_gsd = 1;
  return change_of(round) <= settled_gsd;
}

/// Whether the solver tried steps in a round, and none of them gave a better surface.
bool is_stuck(const RefineIteration& round) {
  return round.accepted_steps == 0 && round.rejected_steps > 0;
}

/// The solver's problems do not limit the confidence if the surface is the prior's.
void judge_solver(const RefineReport& report, FusedSurface& surface) {
  const RefineIteration& last = last_round(report);
  // A round without a better surface than the one before is no movement to judge by.
  const auto moved = std::ranges::find_if(report.iterations.rbegin(), report.iterations.rend(),
                                          [](const auto& round) { return !round.search && !is_stuck(round); });
  std::string problem;
  if (last.failed_tiles > 0) {
    problem = "The refinement could not solve its equations in " + std::to_string(last.failed_tiles) + " of " +
              std::to_string(last.tiles) + " parts of the image: the surface there is that of an earlier round.";
  } else if (moved == report.iterations.rend()) {
    problem = "The refinement found no better surface than the prior.";
  } else if (!is_settled(*moved)) {
    problem = "The refined surface was still changing when the refinement ended, by " +
              with_digits(change_of(*moved), 2) + " GSD in the last round" +
              (is_stuck(last) ? " that found a better one." : ".");
  }
  surface.status = problem.empty() ? FusionStatus::converged : FusionStatus::not_converged;
  if (problem.empty()) return;
  surface.warnings.push_back(problem);
  if (!is_the_prior(report)) surface.confidence.limit(ConfidenceLevel::partial, problem);
}

/// Says so where the images contradict the metal that the station file states.
void judge_stated_metal(const StatedMetalFit& fit, ConfidenceLevel most, FusedSurface& surface) {
  // At the prior's slopes metals had errors up to 0.11, all other materials but black lacquer from 0.27 on.
  constexpr double largest_metal_error = 0.25, clearly_better = 0.5;
  std::string against;
  if (fit.intensity_error > largest_metal_error) {
    against = "the brightness that a mirror of this metal would have is off by " + percent(fit.intensity_error) +
              " (median; of bare metals by less than 15 %)";
  }
  if (fit.stokes_cost > fit.dielectric_stokes_cost + clearly_better) {
    against += against.empty() ? "" : ", and ";
    against += "a material that is not metal explains the polarization clearly better";
  }
  if (against.empty()) return;
  warn(most,
       "The images contradict optics.metal: " + against +
           ". Usual causes are lacquer, patina or paint on the metal, lamps close to the object, or a misplaced prior. "
           "If the object is not bare metal, set metal = \"none\" in [optics].",
       surface);
}

void judge_model(const RefineReport& report, FusedSurface& surface) {
  constexpr double largest_residual = 3;
  // A wrong model does no harm if the surface is the prior's.
  const ConfidenceLevel most = is_the_prior(report) ? ConfidenceLevel::partial : ConfidenceLevel::low;
  if (report.metal) {
    warn(most,
         std::string("The polarization has the direction of a mirror reflection but is much weaker than a "
                     "dielectric's") +
             (report.metal_excluded
                  ? ". optics.metal = \"none\" states that the surface is not bare metal, so the light is probably "
                    "polarized already, or mirrored twice. The Fresnel formulas used here do not hold for it."
                  : ": the surface is probably bare metal, for which the Fresnel formulas used here do not hold. If it "
                    "is, state which one as metal in [optics]."),
         surface);
  }
  if (report.stated_metal) judge_stated_metal(*report.stated_metal, most, surface);
  if (!(report.median_residual <= largest_residual)) {
    warn(most,
         "The reflection model does not explain the measured polarization: the median residual is " +
             with_digits(report.median_residual, 2) + " standard deviations.",
         surface);
  }
  if (std::isnan(report.eta_sigma)) {
    surface.warnings.push_back("The refractive index is not known, and the polarization does not tell it: " +
                               with_digits(report.reflection.eta, 2) +
                               " is used. State it as refractive_index in [optics].");
  } else if (report.stated_eta) {
    const double stated = *report.stated_eta, found = report.reflection.eta;
    warn(ConfidenceLevel::partial,
         "The polarization contradicts optics.refractive_index = " + with_digits(stated, 3) +
             ": it is explained clearly better with " + with_digits(found, 3) +
             ", which the refinement takes. If the stated one is certain, the prior's slopes are too " +
             (found > stated ? "small" : "large") + "; set refine.correct_index = false then.",
         surface);
  }
}

/// Why the surface is the prior's in parts.
std::string why_the_priors(const RefineReport& report) {
  constexpr double much_noise = 0.7;
  std::string model =
      "the reflection model does not explain the polarization, or leads farther from the prior than the prior's errors "
      "allow";
  if (report.shape_share < 1) {
    model =
        "each normal of the object occurs in one small place only, so that relief which the prior lacks cannot be "
        "told from other light (larger images or a denser cloud help), or " +
        model;
  }
  if (!(report.gain_share < much_noise)) return model;
  return "much of what the polarization would change cannot be told from noise (little light, images that do not lie "
         "exactly on each other, texture finer than the pixels), or " +
         model;
}

/// Judges by the evidence at the prior's slopes. A result without any gain is a warning, too.
void judge_evidence(const RefineReport& report, double explained_least, FusedSurface& surface) {
  // Some stations between 0.5 and 0.75 became worse in tests with random light and materials.
  constexpr double well_explained = 0.75;
  Confidence& confidence = surface.confidence;
  if (std::isnan(report.trusted_share)) {
    confidence.limit(ConfidenceLevel::partial,
                     "refine.evidence is off: nothing checks the refined surface against its prior.");
    return;
  }
  if (!has_settled(report)) {
    warn(ConfidenceLevel::partial, "The surface is the prior's: the refined one did not come to rest.", surface);
    return;
  }
  // No cell had enough pixels: the model was not asked, and so nothing speaks against it.
  if (is_the_prior(report) && report.explained_share == 0) {
    warn(
        ConfidenceLevel::partial,
        "The surface is the prior's: no part of the object has enough pixels with usable polarization side by side (64 "
        "in 16 × 16) to tell whether the reflection model holds. Small and thin objects need a closer camera.",
        surface);
    return;
  }
  if (is_the_prior(report)) {
    warn(ConfidenceLevel::partial,
         "The surface is the prior's, or nearly: " + why_the_priors(report) + ". Usual causes are " +
             (report.stated_metal ? "a metal whose color changes" : "metal") +
             ", lamps close to the object, noise, or a misplaced prior.",
         surface);
    return;
  }
  if (!(report.trusted_share >= refined_everywhere)) {
    confidence.limit(ConfidenceLevel::partial, "In " + percent(1 - report.trusted_share) +
                                                   " of the pixels with usable polarization the surface is the "
                                                   "prior's, or nearly: there, " +
                                                   why_the_priors(report) + ".");
  } else if (!(report.explained_share >= well_explained)) {
    confidence.limit(ConfidenceLevel::partial,
                     "At the prior's slopes the reflection model explains the polarization only in part (" +
                         percent(std::max(report.explained_share, 0.0)) + "): fine detail is likely, not certain.");
  } else if (!(report.explained_beyond_plane >= explained_least)) {
    confidence.limit(ConfidenceLevel::partial,
                     "Nearly all of the polarization that the reflection model explains at the prior's slopes is that "
                     "of a plane: it says little of the relief on it. Fine detail is likely, not certain.");
  }
}

/// Says what is assumed of the light where the surface is not the prior's, with or without evidence.
void judge_light(const RefineReport& report, FusedSurface& surface) {
  if (is_the_prior(report)) return;
  if (report.metal_index != 0.0) {
    const std::string index =
        with_digits(report.metal_index.real(), 2) + " + " + with_digits(report.metal_index.imag(), 2) + " i";
    const std::string why =
        report.stated_metal
            ? "The object is treated as bare metal of refractive index " + index + ", as optics.metal states."
            : "The object is taken for bare metal, whose refractive index is about " + index +
                  ": its map of the surroundings explains brightness and polarization.";
    surface.warnings.push_back(why + " Where the color changes, by tarnish or gilding, slopes may be wrong.");
  }
  if (report.reflection.mirrored) {
    surface.confidence.limit(
        ConfidenceLevel::partial,
        "The light is known only from a map of the surroundings that was fitted to this object itself: the "
        "detail is less certain than under an even sky or on a black, mirroring object.");
  }
}

}  // namespace

const RefineIteration& last_round(const RefineReport& report) {
  return *std::ranges::find(report.iterations.rbegin(), report.iterations.rend(), false, &RefineIteration::search);
}

bool has_settled(const RefineReport& report) {
  return is_settled(last_round(report));
}

void judge(const RefineReport& report, double explained_least, FusedSurface& surface) {
  judge_evidence(report, explained_least, surface);
  judge_light(report, surface);
  judge_solver(report, surface);
  judge_model(report, surface);
}

}  // namespace malus
