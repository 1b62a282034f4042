#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>

#include "malus/object/sharpening.h"

namespace malus {

/// What a station's phase says of the normal of a place.
struct PhasePlanes {
  double degree = 0;  ///< of polarization
  /// Unit normals of the planes that hold the surface's normal: first for diffuse, then for specular reflection.
  std::array<Eigen::Vector3d, 2> planes;
};

/// The planes by the phase of the light that comes to a station from a world point.
PhasePlanes phase_planes(const PhasedView& station, const Eigen::Vector3d& point);

/// Whether a normal is so near to one of the two planes, and so far from the other, that the kind of reflection is
/// clear, and the degree is large enough; then the number of the plane.
std::optional<std::size_t> clear_plane(const PhasePlanes& phase, const Eigen::Vector3d& normal);
/// Whether the degree is large enough for a phase to be used.
bool is_strong(const PhasePlanes& phase);

}  // namespace malus
