#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <bit>
#include <cstdint>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/core/large_allocator.h"
#include "malus/core/parallel_internal.h"
#include "malus/linalg/symmetric_solver_internal.h"

namespace malus {

/// Numbers the pixels of a mask row by row.
class PixelIndex {
 public:
  PixelIndex() = default;
  explicit PixelIndex(const Mask& mask);

  int count() const { return static_cast<int>(pixels_.size()); }
  /// Unknown at a pixel, or -1 outside the mask or the raster.
  int at(int u, int v) const { return index_.contains(u, v) ? index_(u, v) : -1; }
  /// Unknowns of a row of the raster, -1 outside the mask.
  const int* row(int v) const { return index_.row(v); }
  int u(int unknown) const { return pixels_[static_cast<std::size_t>(unknown)].u; }
  int v(int unknown) const { return pixels_[static_cast<std::size_t>(unknown)].v; }
  Size size() const { return index_.size(); }
  /// The unknowns of row v are first_of_row(v) … first_of_row(v + 1) − 1.
  int first_of_row(int v) const { return row_starts_[static_cast<std::size_t>(v)]; }

 private:
  struct Pixel {
    int u, v;
  };
  Image<int> index_;
  std::vector<Pixel> pixels_;
  std::vector<int> row_starts_;
};

/// Normal equations of a least-squares problem with one unknown per pixel, in which each equation involves pixels at
/// most `reach` apart along each axis. The sparsity pattern grows with each new entry and is kept when the values are
/// cleared, so that a solver's analysis stays valid.
class GridSystem {
 public:
  /// Largest distance of two coupled pixels along each axis.
  static constexpr int reach = 2;

  explicit GridSystem(const PixelIndex& pixels);

  void clear(const Context& context);
  /// Calls body(unknown) for every unknown, on the context's threads. Entries are added in the same order with any
  /// number of threads. `body` may add entries between unknowns up to `reach` rows from its own.
  template <class Body>
  void for_each_unknown(const Context& context, Body&& body) const {
    // A strip of rows also adds to entries up to `reach` rows outside it, so only every second strip runs at a time.
    constexpr int strip_rows = 16;
    static_assert(strip_rows > 2 * reach);
    const int height = pixels_->size().height, strips = (height + strip_rows - 1) / strip_rows;
    for (int parity = 0; parity < 2; ++parity) {
      parallel_for(context, static_cast<std::size_t>((strips + 1 - parity) / 2), 1, [&](std::size_t k, std::size_t) {
        const int top = (2 * static_cast<int>(k) + parity) * strip_rows;
        const int end = pixels_->first_of_row(std::min(top + strip_rows, height));
        for (int i = pixels_->first_of_row(top); i < end; ++i) body(i);
      });
    }
  }
  /// Adds to the symmetric entry of two unknowns; call it once per pair, not once per order. `reach` is not checked.
  void add(int a, int b, double value) {
    if (a > b) std::swap(a, b);
    add_to_later(a, pixels_->u(b) - pixels_->u(a), pixels_->v(b) - pixels_->v(a), value);
  }
  /// The same for an unknown with itself, or with a later one that lies (du, dv) pixels from it.
  void add_to_later(int a, int du, int dv, double value) {
    const std::size_t column = static_cast<std::size_t>(a);
    const int slot = slot_of(du, dv);
    values_[column * slots + static_cast<std::size_t>(slot)] += value;
    used_[column] = static_cast<std::uint16_t>(used_[column] | (1u << slot));
  }
  void add_right(int a, double value) { right_[a] += value; }
  /// Adds weight · (coefficients · x − target)² over `count` unknowns.
  void add_row(const int* unknowns, const double* coefficients, int count, double target, double weight) {
    for (int i = 0; i < count; ++i) {
      add_right(unknowns[i], weight * coefficients[i] * target);
      for (int j = 0; j <= i; ++j) add(unknowns[i], unknowns[j], weight * coefficients[i] * coefficients[j]);
    }
  }

  const PixelIndex& pixels() const { return *pixels_; }
  /// Calls visit(du, dv, value) for the entries of an unknown: with itself, and with every later unknown that it was
  /// ever coupled with, (du, dv) pixels away.
  template <class Visit>
  void for_each_entry(int unknown, Visit&& visit) const {
    const std::size_t column = static_cast<std::size_t>(unknown);
    const double* values = values_.data() + column * slots;
    for (unsigned used = used_[column]; used != 0; used &= used - 1) {
      const int slot = std::countr_zero(used);
      visit(column_offset(slot), row_offset(slot), values[slot]);
    }
  }
  /// Lower triangle with `ridge` added to the diagonal.
  SymmetricSolver::Matrix lower(double ridge) const;
  const Eigen::VectorXd& right() const { return right_; }
  /// Largest diagonal entry.
  double largest_diagonal() const;

 private:
  // The later pixel of a pair lies in the same row to the right, or in one of the next rows.
  static constexpr int slots = reach + 1 + reach * (2 * reach + 1);
  static constexpr int slot_of(int du, int dv) {
    return dv == 0 ? du : reach + 1 + (dv - 1) * (2 * reach + 1) + du + reach;
  }

  static constexpr int row_offset(int slot) { return slot <= reach ? 0 : (slot - reach - 1) / (2 * reach + 1) + 1; }
  static constexpr int column_offset(int slot) {
    return slot <= reach ? slot : (slot - reach - 1) % (2 * reach + 1) - reach;
  }

  const PixelIndex* pixels_;
  LargeVector<double> values_;
  std::vector<std::uint16_t> used_;
  Eigen::VectorXd right_;
};

}  // namespace malus
