#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "malus/core/context.h"
#include "malus/polarization/phase_cells_internal.h"
#include "malus/polarization/stokes_frame_internal.h"

namespace malus {

/// Further unknowns that are fitted with the frame.
enum class FrameTerms {
  none,
  slopes,  ///< a polarization of the scene that changes linearly with the slopes, as that of a wide highlight
  radial,  ///< the component along the azimuth depends on the zenith alone, as on mirroring objects
};

/// The least squares of estimate_frame: turn and boosts for which polarization has no component across the azimuths.
class FrameFit {
 public:
  FrameFit(std::vector<PhaseCell> cells, FrameTerms terms);

  /// Iterates from `start` until the frame's corrections vanish.
  StokesFrame solve(const StokesFrame& start, const Context& context);

  /// Covariance of (b1, b2, δ) at the frame found: H⁻¹ Σ g gᵀ H⁻¹ over parts of the image and over zones around the
  /// highlight, whichever has the larger trace.
  Eigen::Matrix3d covariance(const StokesFrame& frame);

 private:
  /// Number of nodes (zeniths) of a mirroring object's radial profile, which is linear between them.
  static constexpr int profile_nodes = 10;
  /// One step's unknowns: b1, b2, δ, then the radial profile or the derivatives of b1 and b2 by p and q.
  using Vector = Eigen::Matrix<double, 3 + profile_nodes, 1>;
  using Matrix = Eigen::Matrix<double, 3 + profile_nodes, 3 + profile_nodes>;

  struct Equation {
    Vector row = Vector::Zero();
    double value = 0, weight = 1;
  };

  std::array<Equation, 2> equations_of(const PhaseCell& cell, const Eigen::Vector3d& stokes) const;
  double squared_residual(const Equation& equation) const;
  void update_scales(const StokesFrame& frame, bool first);
  void accumulate(const StokesFrame& frame);

  std::vector<PhaseCell> cells_;
  std::vector<int> parts_;
  FrameTerms terms_;
  std::array<double, 2> scales_{1, 1};  ///< robust scale (squared) of each of the two kinds of residual
  Vector solution_ = Vector::Zero(), right_ = Vector::Zero();
  Matrix normal_ = Matrix::Zero();
  std::vector<Vector> by_part_, by_zone_;
};

}  // namespace malus
