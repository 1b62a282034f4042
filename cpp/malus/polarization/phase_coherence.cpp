#include <algorithm>
#include <array>
#include <cmath>
#include <complex>

#include "malus/polarization/phase_coherence_internal.h"
#include "malus/polarization/phase_weight_internal.h"

namespace malus {
namespace {

using Complex = std::complex<double>;

constexpr double min_ahead = 3, min_ahead_to_contradict = 4, min_coherence = 0.3;
/// The scatter over fewer parts, as of two or three small islands, is small by chance too often: with two, one ratio in
/// five exceeds three standard deviations.
constexpr std::size_t fewest_parts = 4;

/// Weighted sums over cells; phases, azimuths and their products are of unit modulus.
struct Sums {
  double weight = 0;
  Complex phase, azimuth, direct, opposite;

  Sums& operator+=(const Sums& other) {
    weight += other.weight;
    phase += other.phase;
    azimuth += other.azimuth;
    direct += other.direct;
    opposite += other.opposite;
    return *this;
  }
  Sums without(const Sums& part) const {
    return {weight - part.weight, phase - part.phase, azimuth - part.azimuth, direct - part.direct,
            opposite - part.opposite};
  }
};

struct Correlations {
  Complex direct, opposite;
  double disagreement = 0;
};

Correlations correlations(const Sums& sums) {
  const Complex phase = sums.phase / sums.weight, azimuth = sums.azimuth / sums.weight;
  const double scale = 1 / std::sqrt(std::max((1 - std::norm(phase)) * (1 - std::norm(azimuth)), 1e-12));
  const double cosine = sums.direct.real() / sums.weight;  // of 4 (phase − azimuth)
  return {scale * (sums.direct / sums.weight - phase * std::conj(azimuth)),
          scale * (sums.opposite / sums.weight - std::conj(phase * azimuth)),
          std::sqrt(std::max(0.5 * (1 - cosine), 0.0))};
}

/// Standard deviation by the jackknife: `values` are the results with one part left out each.
double jackknife_sigma(const std::vector<double>& values) {
  const auto count = static_cast<Eigen::Index>(values.size());
  const Eigen::Map<const Eigen::ArrayXd> results(values.data(), count);
  return std::sqrt(static_cast<double>(count - 1) * (results - results.mean()).square().mean());
}

}  // namespace

PhaseCoherence phase_coherence(const std::vector<PhaseCell>& cells) {
  PhaseCoherence result;
  result.cells = cells.size();
  const std::vector<int> parts = parts_of(cells, parts_per_side);
  std::array<Sums, parts_per_side * parts_per_side> by_part;
  for (std::size_t i = 0; i < cells.size(); ++i) {
    const PhaseCell& cell = cells[i];
    const Complex polarization = cell.polarization();
    const double degree2 = std::max(std::norm(polarization), 1e-12);
    const double of_phase = phase_variance(cell.variance, degree2), of_azimuth = azimuth_variance(cell.slopes.tan2());
    result.phases_known += angle_weight(of_phase);
    result.azimuths_known += angle_weight(of_azimuth);
    const double weight = angle_weight(of_phase + of_azimuth);
    const Complex phase = polarization * polarization / degree2, azimuth = cell.azimuth() * cell.azimuth();
    by_part[static_cast<std::size_t>(parts[i])] +=
        Sums{weight, weight * phase, weight * azimuth, weight * phase * std::conj(azimuth),
             weight * std::conj(phase * azimuth)};
  }
  Sums total;
  for (const Sums& part : by_part) total += part;
  if (!(total.weight > 0)) return result;
  result.phases_known /= static_cast<double>(cells.size());
  result.azimuths_known /= static_cast<double>(cells.size());

  const Correlations all = correlations(total);
  std::vector<double> disagreements, directs, aheads, turns;
  for (const Sums& part : by_part) {
    const Sums rest = total.without(part);
    if (!(part.weight > 0) || !(rest.weight > 1e-9 * total.weight)) continue;
    const Correlations without = correlations(rest);
    disagreements.push_back(without.disagreement);
    directs.push_back(std::abs(without.direct));
    aheads.push_back(std::abs(without.direct) - std::abs(without.opposite));
    turns.push_back(std::arg(without.direct * std::conj(all.direct)) / 4);
  }
  result.disagreement = all.disagreement;
  result.direct = std::abs(all.direct);
  result.opposite = std::abs(all.opposite);
  result.turn_rad = std::arg(all.direct) / 4;
  result.opposite_turn_rad = std::arg(all.opposite) / 4;
  if (directs.size() < fewest_parts) return result;
  result.disagreement_sigma = jackknife_sigma(disagreements);
  result.direct_sigma = jackknife_sigma(directs);
  result.ahead_sigma = jackknife_sigma(aheads);
  result.turn_sigma_rad = jackknife_sigma(turns);
  return result;
}

bool knows_direction(const PhaseCoherence& coherence) {
  const bool is_ahead = coherence.ahead() > min_ahead || coherence.ahead() < -min_ahead_to_contradict;
  return is_ahead && std::max(coherence.direct, coherence.opposite) > min_coherence;
}

bool knows_zero(const PhaseCoherence& coherence) {
  return knows_direction(coherence) && std::abs(coherence.ahead()) > min_ahead_to_contradict;
}

}  // namespace malus
