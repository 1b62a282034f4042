#pragma once

#include "malus/core/context.h"
#include "malus/fusion/fused_surface.h"
#include "malus/height/height_map.h"
#include "malus/options/fusion_options.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// The paper's transfer of polarization detail onto the photogrammetric surface (Eq 14 to 16).
///
/// Both surfaces are heights in GSD (see height_map.h; the prior is converted to the height's form, perspective or
/// orthographic). Parts of the height that nothing connects have a free constant each; they are first moved to where
/// the prior has them, relative to the largest part. At the nodes of a grid of `grid_px` pixels the difference of both
/// surfaces, prior − polarization, is taken (Eq 14), smoothed by a Gaussian over the nodes (Eq 15), interpolated
/// bilinearly to the pixels and added to the polarization height (Eq 16): low frequencies come from the prior, detail
/// from polarization. Nodes where either surface is missing have no weight. With `unit_scaling` both are mapped to 0 …
/// 1 first and the sum is mapped back with the prior's range, as printed.
///
/// A pixel with a prior but no polarization height keeps the prior. sigma² is the prior's variance plus the local mean
/// square (the same Gaussian) of the part of the difference that the smoothing removed, which is the disagreement of
/// both surfaces in detail. Throws an input error for rasters of another size, or if the grid is so wide that no node
/// lies on the object; a data error if there is no height, with the reason, or if no pixel has both surfaces.
FusedSurface fuse_grid(const HeightMap& height, const DepthPrior& prior, const GridFusionOptions& options,
                       const Context& context);

}  // namespace malus
