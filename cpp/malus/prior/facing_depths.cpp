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
      away_(facing_) {}

void FacingDepths::add(int u, int v, double depth, bool faces) {
  float& nearest = (faces ? facing_ : away_)(u / cell_px_, v / cell_px_);
  nearest = std::min(nearest, static_cast<float>(depth));
}

void FacingDepths::add(const FacingDepths& other) {
  for (std::size_t i = 0; i < facing_.count(); ++i) {
    facing_[i] = std::min(facing_[i], other.facing_[i]);
    away_[i] = std::min(away_[i], other.away_[i]);
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

}  // namespace malus
