#include <cmath>
#include <limits>
#include <sstream>

#include "malus/core/degrees_internal.h"
#include "malus/evidence/phase_agreement_internal.h"
#include "malus/polarization/phase_cells_internal.h"

namespace malus {
namespace {

/// In small views a coarse prior has no azimuths of its own. With at least `min_cells`, none of 97 rendered stations is
/// found unrelated.
constexpr std::size_t min_cells = 2000, min_cells_of_part = 50;
/// Mean weights below which phases or azimuths are not known well enough to expect an agreement.
constexpr double known_enough = 0.3;
/// Correlation below which well-known phases and azimuths count as unrelated; right stations reach 0.33 and more.
constexpr double weak_coherence = 0.2;
/// Error of the polarizer's zero above which the finding is a warning.
constexpr double large_turn_rad = to_radians(10);
constexpr double unrelated = 0.6;

PhaseAgreement::Part part_of(const std::vector<PhaseCell>& cells) {
  PhaseAgreement::Part part;
  part.cells = static_cast<double>(cells.size());
  part.disagreement = std::numeric_limits<double>::quiet_NaN();
  if (cells.size() < min_cells_of_part) return part;
  for (const PhaseCell& cell : cells) {
    part.u += cell.u / part.cells;
    part.v += cell.v / part.cells;
  }
  const PhaseCoherence coherence = phase_coherence(cells);
  part.disagreement = coherence.disagreement;
  part.disagreement_sigma = coherence.disagreement_sigma;
  return part;
}

Finding finding_of(PhaseAgreement& agreement) {
  const PhaseCoherence& overall = agreement.overall;
  Finding finding;
  finding.check = Check::phase;
  finding.figures = {{"cells", static_cast<double>(overall.cells)},
                     {"disagreement", overall.disagreement},
                     {"disagreement_sigma", overall.disagreement_sigma},
                     {"correlation", overall.direct},
                     {"correlation_sigma", overall.direct_sigma},
                     {"azimuths_known", overall.azimuths_known},
                     {"phases_known", overall.phases_known},
                     {"unrelated_share", agreement.unrelated_share}};
  std::ostringstream text;
  text.precision(2);
  if (knows_direction(overall) && overall.ahead() < 0) {
    finding.severity = Severity::error;
    text << "the polarization turns against the slopes of the prior: correlation " << overall.direct << " as given, "
         << overall.opposite << " with the polarizer counted the other way";
    finding.message = text.str();
    finding.suggestion = "expected the other angle_direction, unless the prior is mirrored";
    return finding;
  }
  if (knows_zero(overall) && std::abs(overall.turn_rad) > large_turn_rad + 5 * overall.turn_sigma_rad) {
    finding.severity = Severity::warning;
    text << "the phases of polarization are " << to_degrees(overall.turn_rad) << "° ± "
         << to_degrees(overall.turn_sigma_rad) << "° larger than the prior's azimuths everywhere";
    finding.message = text.str();
    finding.suggestion = "is angle_zero_deg right, or is the prior turned in the image?";
    return finding;
  }
  const bool has_scatter = overall.direct_sigma > 0;
  if (knows_direction(overall) || (has_scatter && overall.direct > weak_coherence + 2 * overall.direct_sigma)) {
    text << "the polarization fits the slopes of the prior: correlation " << overall.direct << " ± "
         << overall.direct_sigma;
    finding.message = text.str();
    return finding;
  }
  const char* unknown = nullptr;
  if (overall.azimuths_known < known_enough)
    unknown = "the prior is too flat";
  else if (overall.phases_known < known_enough)
    unknown = "there is too little polarization for the noise";
  else if (!has_scatter)
    unknown = "the object's pixels lie in too few places";
  else if (overall.cells < min_cells)
    unknown = "there are too few pixels";
  else if (overall.direct > weak_coherence)
    unknown = "they are related only weakly";
  if (unknown != nullptr) {
    finding.message = std::string("whether the polarization fits the prior could not be checked: ") + unknown;
    return finding;
  }
  agreement.is_unrelated = true;
  finding.severity = Severity::warning;
  text << "the polarization is unrelated to the slopes of the prior (correlation " << overall.direct << " ± "
       << overall.direct_sigma << ", 0 = unrelated), though both are known well";
  finding.message = text.str();
  finding.suggestion =
      "is the prior in the right place, are the images of this object, and the angles in the order of the images? "
      "Bare metal does this, too: state which one as metal in [optics]";
  return finding;
}

}  // namespace

PhaseAgreement phase_agreement(const PolarizationState& state, const Pinhole* camera, const Image<float>& normals,
                               const Context& context) {
  const std::vector<PhaseCell> cells = phase_cells(state, camera, normals, context);
  PhaseAgreement agreement;
  agreement.overall = phase_coherence(cells);
  const std::vector<int> part_numbers = parts_of(cells, PhaseAgreement::parts_per_side);
  std::vector<std::vector<PhaseCell>> parts(PhaseAgreement::parts_per_side * PhaseAgreement::parts_per_side);
  for (std::size_t i = 0; i < cells.size(); ++i) parts[static_cast<std::size_t>(part_numbers[i])].push_back(cells[i]);
  double known = 0, bad = 0;
  for (const std::vector<PhaseCell>& cells_of_part : parts) {
    agreement.parts.push_back(part_of(cells_of_part));
    const PhaseAgreement::Part& part = agreement.parts.back();
    if (std::isnan(part.disagreement)) continue;
    ++known;
    if (part.disagreement - 2 * part.disagreement_sigma > unrelated) ++bad;
  }
  agreement.unrelated_share = known > 0 ? bad / known : 0;
  agreement.finding = finding_of(agreement);
  return agreement;
}

}  // namespace malus
