#pragma once

#include <Eigen/Core>
#include <complex>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/ray_frame.h"

namespace malus {

/// A square cell of pixels: its mean polarization, and the slopes that a surface has there.
struct PhaseCell {
  double u = 0, v = 0;                                ///< its center [px]
  Eigen::Vector3d stokes = Eigen::Vector3d::Zero();   ///< mean Stokes vector
  double variance = 0;                                ///< of s1 / s0 and of s2 / s0, by the noise model
  Slopes slopes;                                      ///< of the surface, in the frame of the pixels' rays
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< of the surface, camera frame
  Eigen::Vector3d view = -Eigen::Vector3d::UnitZ();   ///< from the surface to the camera
  double from_highlight_rad = 0;  ///< angle between normal and half vector of light and view; set by estimate_frame

  /// (s1 + i s2) / s0: its modulus is the degree, half its argument the phase.
  std::complex<double> polarization() const { return {stokes[1] / stokes[0], stokes[2] / stokes[0]}; }
  /// exp(2i azimuth) of the surface.
  std::complex<double> azimuth() const {
    return std::complex<double>(slopes.p, slopes.q) * std::complex<double>(slopes.p, slopes.q) / slopes.tan2();
  }
  /// Component of the polarization along the surface's azimuth (real part: positive for diffuse, negative for specular
  /// reflection) and across it (imaginary part: zero for either).
  std::complex<double> radial() const { return polarization() * std::conj(azimuth()); }
};

/// Cells in which most pixels are valid and have a surface inclined by 5° or more; at smaller slopes an azimuth is
/// meaningless. Cells serve because means have less noise than pixels, and a prior has no finer detail: about 25 000
/// cells of 2 to 4 px, in large images 100 000 larger ones. Mean slopes are weighted by brightness, as the mean Stokes
/// vector is by nature.
///
/// camera null = orthographic. normals: 3 channels, unit, camera frame, towards the camera, NaN = none; of the state's
/// size, else an input error.
std::vector<PhaseCell> phase_cells(const PolarizationState& state, const Pinhole* camera, const Image<float>& normals,
                                   const Context& context);

/// Index of the image part that each cell lies in: side × side parts of the bounding box of all cells, row by row.
std::vector<int> parts_of(const std::vector<PhaseCell>& cells, int side);
/// Usual number of parts along a side, whose scatter shows how errors of neighboring cells go together.
inline constexpr int parts_per_side = 8;

}  // namespace malus
