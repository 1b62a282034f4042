#pragma once

#include "malus/core/context.h"
#include "malus/core/fields.h"
#include "malus/fusion/fused_surface.h"
#include "malus/height/height_map.h"
#include "malus/prior/depth_prior.h"

namespace malus {

struct GridFusionOptions {
  int grid_px = 4;
  double sigma_nodes = 1;
  bool unit_scaling = false;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("grid_px", self.grid_px, Range{1, 4096}, "distance of the grid's nodes");
    visit("sigma_nodes", self.sigma_nodes, Range{0, 1000}, "Gaussian on the grid, standard deviation in nodes");
    visit("unit_scaling", self.unit_scaling, any_value,
          "scale both surfaces to 0 … 1 before combining them, as printed; loses the metric relation of their scales");
  }
};

/// The paper's transfer of polarization detail onto the photogrammetric surface (Eq 14 to 16).
///
/// Both surfaces are heights in GSD (see height_map.h; the prior in the form that the height has). At the nodes of a
/// grid of `grid_px` pixels their difference, prior − polarization, is taken (Eq 14), smoothed by a Gaussian over the
/// nodes (Eq 15), interpolated bilinearly to the pixels and added to the polarization height (Eq 16): low frequencies
/// come from the prior, detail from polarization. Nodes where either surface is missing have no weight. With
/// `unit_scaling` both are mapped to 0 … 1 first and the sum is mapped back with the prior's range, as printed.
///
/// A pixel with a prior but no polarization height keeps the prior. sigma² is the prior's variance plus the local mean
/// square (the same Gaussian) of the difference that the smoothing took out: how much both disagree in detail. Throws
/// an input error for rasters of another size, a data error if no node has both surfaces.
FusedSurface fuse_grid(const HeightMap& height, const DepthPrior& prior, const GridFusionOptions& options,
                       const Context& context);

}  // namespace malus
