#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "malus/core/cell_values_internal.h"
#include "malus/prior/facing_depths_internal.h"

namespace malus {
namespace {

constexpr int cells_per_side = 64;
constexpr float no_point = std::numeric_limits<float>::infinity();

}  // namespace

FacingDepths::FacingDepths(Size size)
    : cell_px_((std::max(size.width, size.height) + cells_per_side - 1) / cells_per_side),
      facing_(cells_over(size, cell_px_), 1, no_point),
      away_(facing_),
      facing_count_(facing_.size()),
      away_count_(facing_.size()) {}

void FacingDepths::add(int u, int v, double depth, bool faces) {
  const int column = u / cell_px_, row = v / cell_px_;
  float& nearest = (faces ? facing_ : away_)(column, row);
  nearest = std::min(nearest, static_cast<float>(depth));
  ++(faces ? facing_count_ : away_count_)(column, row);
}

void FacingDepths::add(const FacingDepths& other) {
  for (std::size_t i = 0; i < facing_.count(); ++i) {
    facing_[i] = std::min(facing_[i], other.facing_[i]);
    away_[i] = std::min(away_[i], other.away_[i]);
    facing_count_[i] += other.facing_count_[i];
    away_count_[i] += other.away_count_[i];
  }
}

bool FacingDepths::are_reversed(double focal) const {
  // Within a cell a surface that is steeper than 75 degrees rises by this many GSD a pixel.
  constexpr double steepest = 4;
  // Stray points face anywhere and lie anywhere, but only in few cells.
  constexpr double mostly = 0.7, least_share = 0.25;
  double facing = 0, both = 0, reversed = 0;
  for (std::size_t i = 0; i < facing_.count(); ++i) {
    if (!std::isfinite(facing_[i])) continue;
    ++facing;
    if (!std::isfinite(away_[i])) continue;
    ++both;
    reversed += focal * (facing_[i] - away_[i]) / facing_[i] > steepest * cell_px_;
  }
  return reversed > mostly * both && reversed > least_share * facing;
}

double FacingDepths::away_only() const {
  // Of so many points in a cell of a closed object, hardly ever all belong to its back by chance.
  constexpr int several = 12, least_cells = 10;
  constexpr int coarsest = cells_per_side / 4;
  for (int side = 1; side <= coarsest; side *= 2) {
    const Size cells = cells_over(facing_count_.size(), side);
    Image<int> facing(cells), away(cells);
    for_each_pixel(facing_count_.size(), [&](int u, int v) {
      facing(u / side, v / side) += facing_count_(u, v);
      away(u / side, v / side) += away_count_(u, v);
    });
    int seen = 0, judged = 0, turned = 0;
    for (std::size_t i = 0; i < facing.count(); ++i) {
      const int points = facing[i] + away[i];
      seen += points > 0;
      judged += points >= several;
      turned += points >= several && facing[i] == 0;
    }
    if (2 * judged > seen && judged >= least_cells) return static_cast<double>(turned) / judged;
  }
  return 0;
}

}  // namespace malus
