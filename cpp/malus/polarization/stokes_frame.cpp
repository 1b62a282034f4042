#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "malus/core/parallel_internal.h"
#include "malus/polarization/stokes_frame_internal.h"

namespace malus {

StokesFrame turned_scale(double rad) {
  const double cosine = std::cos(2 * rad), sine = std::sin(2 * rad);
  StokesFrame frame;
  frame << 1, 0, 0, 0, cosine, -sine, 0, sine, cosine;
  return frame;
}

StokesFrame mirrored_scale() {
  return Eigen::Vector3d(1, 1, -1).asDiagonal();
}

StokesFrame boost(double b1, double b2) {
  const double squared = b1 * b1 + b2 * b2;
  if (squared == 0) return StokesFrame::Identity();
  const double gamma = 1 / std::sqrt(1 - squared), share = (gamma - 1) / squared;
  StokesFrame frame;
  frame << gamma, gamma * b1, gamma * b2,                //
      gamma * b1, 1 + share * b1 * b1, share * b1 * b2,  //
      gamma * b2, share * b1 * b2, 1 + share * b2 * b2;
  return frame;
}

void apply_frame(PolarizationState& state, const StokesFrame& frame, const Context& context) {
  const StokesFrame inverse = frame.inverse();
  for (double& angle : state.angles_rad) {
    const Eigen::RowVector3d row = Eigen::RowVector3d(1, std::cos(2 * angle), std::sin(2 * angle)) * inverse;
    angle = 0.5 * std::atan2(row[2], row[1]);
  }
  parallel_pixels(context, state.size(), [&](int u, int v) {
    if (!std::isfinite(state.i_un(u, v))) return;
    const Eigen::Vector3d stokes = frame * state.stokes(u, v);
    const double linear = std::hypot(stokes[1], stokes[2]);
    state.i_un(u, v) = static_cast<float>(0.5 * stokes[0]);
    state.rho(u, v) = stokes[0] > 0 ? static_cast<float>(std::min(linear / stokes[0], 1.0)) : 0.0f;
    state.phi(u, v) = phase_of(stokes);
  });
}

}  // namespace malus
