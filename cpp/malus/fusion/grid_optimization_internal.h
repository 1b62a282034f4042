#pragma once

#include <Eigen/Core>

#include "malus/core/context.h"
#include "malus/fusion/fused_surface.h"
#include "malus/options/fusion_options.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/reflection.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// Input of the equations at each pixel. Rasters have the surface's size.
struct OptimizeInput {
  const PolarizationState& polarization;
  const ReflectionMap& reflection;
  const DepthPrior& prior;
  Eigen::Vector4d light;    ///< HeightMap::light
  bool perspective = true;  ///< HeightMap::perspective
  int cell_px = 4;          ///< GridFusionOptions::grid_px
};

/// An interpretation of the "simultaneous optimization" that the paper names after Eq 16 without details.
///
/// Nonlinear least squares (Ceres) on one height per pixel, starting from the surface of the grid transfer. Residuals
/// of a pixel with usable polarization, with the unit normal n once from differences to the next pixels along u and v
/// and once from differences to the previous ones, so that no side is preferred:
///   Eq 9          n · (sin α · right − cos α · up), α the azimuth of the phase,
///   Eq 11         (l · n + ambient − i_un) / |l|,
///   Eq 7 or Eq 8  n · view − cos θ,
///   prior         a tenth of the difference of both slopes to the prior's, as the three above are bounded (decision
///   45);
/// and for each cell of the grid the mean difference to the prior. Tiles of 256 px, whose neighborhood is held fixed,
/// bound the memory. Depth and normals of the surface are replaced; sigma stays that of the grid transfer. Its status
/// is "converged" if all tiles converged, "not converged" if some could not be solved, else "iteration limit". Throws
/// an input error for rasters of another size, if there is no light, or for cells wider than 32 px, whose means take
/// too much memory; a resource error if the linear solver gets no memory.
void optimize_grid_surface(FusedSurface& surface, const OptimizeInput& input, const OptimizeOptions& options,
                           const Context& context);

}  // namespace malus
