#include <algorithm>
#include <bit>

#include "malus/linalg/grid_system_internal.h"

namespace malus {

PixelIndex::PixelIndex(const Mask& mask) : index_(mask.size(), 1, -1) {
  row_starts_.reserve(static_cast<std::size_t>(mask.height()) + 1);
  for (int v = 0; v < mask.height(); ++v) {
    row_starts_.push_back(count());
    for (int u = 0; u < mask.width(); ++u) {
      if (mask(u, v) == 0) continue;
      index_(u, v) = static_cast<int>(pixels_.size());
      pixels_.push_back({u, v});
    }
  }
  row_starts_.push_back(count());
}

GridSystem::GridSystem(const PixelIndex& pixels)
    : pixels_(&pixels),
      values_(static_cast<std::size_t>(pixels.count()) * slots, 0.0),
      used_(static_cast<std::size_t>(pixels.count()), 1),
      right_(Eigen::VectorXd::Zero(pixels.count())) {}

void GridSystem::clear(const Context& context) {
  parallel_for(context, values_.size(), std::size_t{1} << 17, [&](std::size_t begin, std::size_t end) {
    std::fill(values_.begin() + static_cast<std::ptrdiff_t>(begin), values_.begin() + static_cast<std::ptrdiff_t>(end),
              0.0);
  });
  right_.setZero();
}

SymmetricSolver::Matrix GridSystem::lower(double ridge) const {
  const int count = pixels_->count();
  SymmetricSolver::Matrix matrix(count, count);
  int entries = 0;
  for (const std::uint16_t used : used_) entries += std::popcount(used);
  matrix.resizeNonZeros(entries);
  int next = 0;
  for (int a = 0; a < count; ++a) {
    matrix.outerIndexPtr()[a] = next;
    // Slots are in the order of the pixels' numbers, so row indices are sorted.
    for_each_entry(a, [&](int du, int dv, double value) {
      matrix.innerIndexPtr()[next] = pixels_->at(pixels_->u(a) + du, pixels_->v(a) + dv);
      matrix.valuePtr()[next] = value + (du == 0 && dv == 0 ? ridge : 0.0);
      ++next;
    });
  }
  matrix.outerIndexPtr()[count] = next;
  return matrix;
}

double GridSystem::largest_diagonal() const {
  double largest = 0;
  for (std::size_t i = 0; i < values_.size(); i += slots) largest = std::max(largest, values_[i]);
  return largest;
}

}  // namespace malus
