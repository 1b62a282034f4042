#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

#include "malus/object/phase_planes_internal.h"
#include "malus/object/surface_cells_internal.h"

namespace malus {

/// Finds the relative depth change (growth) of every pixel so that the surface normals agree with the phases measured
/// by the stations, within the surface's standard deviations and as smoothly as possible.
class PhaseFit {
 public:
  /// Looks the cells up in the stations. The cells must outlive the fit.
  PhaseFit(const SurfaceCells& cells, std::span<const PhasedView> stations, const Context& context);

  /// Growth of every unknown, by Gauss–Newton steps.
  Eigen::VectorXd growth(const Context& context) const;

 private:
  /// The phases of the cells that begin at the unknowns of a block, cell by cell; those of the cell at the block's
  /// unknown i are phases[begins[i]] … phases[begins[i + 1] − 1].
  struct Block {
    std::vector<PhasePlanes> phases;
    std::vector<std::size_t> begins;
  };

  std::span<const PhasePlanes> phases_of(int unknown) const;
  void add_equations(int unknown, const Eigen::VectorXd& growth, GridSystem& system) const;
  void add_place(int unknown, const Eigen::VectorXd& growth, GridSystem& system) const;
  void add_bend(const std::array<int, 3>& line, const Eigen::VectorXd& growth, GridSystem& system) const;
  void add_phases(int unknown, const Eigen::VectorXd& growth, GridSystem& system) const;

  const SurfaceCells& cells_;
  std::vector<Block> blocks_;
};

}  // namespace malus
