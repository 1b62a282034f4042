#pragma once

#include <vector>

#include "malus/polarization/phase_cells_internal.h"

namespace malus {

/// How well the phases of polarization go with the azimuths of a surface, whatever each place reflects: a diffuse phase
/// equals the azimuth, a specular one is 90° from it, and exp(4i phase) = exp(4i azimuth) for both.
struct PhaseCoherence {
  std::size_t cells = 0;

  /// Root mean square of sin 2(phase − azimuth): 0 = phases as the azimuths demand, 0.71 = unrelated data.
  double disagreement = 0.7071, disagreement_sigma = 0;

  /// Modulus of the correlation of exp(4i phase) with exp(4i azimuth), its means taken out: 0 = unrelated, 1 = the
  /// same but for a common turn. `opposite`: the same with phases of the other sign, as they are when the polarizer's
  /// scale was read in the wrong direction.
  double direct = 0, opposite = 0;
  double direct_sigma = 0;
  double ahead_sigma = 0;  ///< of direct − opposite

  /// By how much phases are larger than the azimuths, modulo 90°, in (−45°, 45°]; for the other direction, by how much
  /// the phases of changed sign are.
  double turn_rad = 0, turn_sigma_rad = 0;
  double opposite_turn_rad = 0;

  /// Mean weights of the cells, in [0, 1]: by how well the surface's azimuths are known (small = it is too flat), and
  /// by how well phases are (small = too little polarization for the noise).
  double azimuths_known = 0, phases_known = 0;

  /// Standard deviations by which the direction as given is better than the other one; negative = worse.
  double ahead() const { return ahead_sigma > 0 ? (direct - opposite) / ahead_sigma : 0; }
};

/// Correlations over cells weighted by (1 + 8 variance of their angle)⁻², the variance being that of a phase by its
/// noise and that of an azimuth of slopes that are uncertain by 0.15; 8 from E exp(4i x) = exp(−8 variance). With the
/// means taken out the correlation is zero for unrelated data even where both have a preferred direction, such as the
/// polarized light of a lamp on a curved panel. Standard deviations are those of a jackknife over 8 × 8 parts of the
/// image, so that what neighboring cells have in common does not make them too small.
PhaseCoherence phase_coherence(const std::vector<PhaseCell>& cells);

/// Whether the data tell which way the scale counts. Of some 500 rendered stations, unrelated ones among them, one is
/// wrong about it, by 3.6 standard deviations (a painting under two lamps); 0.3 of coherence and 3 standard deviations
/// are asked for, or 4 to contradict what a person has stated.
bool knows_direction(const PhaseCoherence& coherence);

/// Whether they tell its zero, too, so well that the standard deviation of the turn can be believed (4 and 0.3; below
/// that metals have been off by 6 of them).
bool knows_zero(const PhaseCoherence& coherence);

}  // namespace malus
