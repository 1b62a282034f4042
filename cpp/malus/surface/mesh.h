#pragma once

#include "malus/core/context.h"
#include "malus/core/fields.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/fusion/fused_surface.h"

namespace malus {

struct SurfaceOptions {
  int subsample = 1;
  double max_incidence_deg = 85;
  double min_step_gsd = 4;
  double step_ratio = 3;
  double max_sigma_gsd = 10;
  double white_percentile = 99.5;
  std::optional<double> dem_pixel;
  int glb_triangles = 500000;
  int glb_texture_px = 4096;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("subsample", self.subsample, Range{1, 64}, "the mesh has every n-th pixel as a vertex");
    visit("max_incidence_deg", self.max_incidence_deg, Range{45, 90},
          "triangles seen flatter than this (normal to viewing ray) are left out: the sides of depth steps");
    visit("min_step_gsd", self.min_step_gsd, not_negative,
          "depth steps between neighboring pixels up to this many GSD are never cut by step_ratio");
    visit("step_ratio", self.step_ratio, Range{1, 1e6},
          "a larger step is cut if it exceeds this many times the steps right before and after it");
    visit("max_sigma_gsd", self.max_sigma_gsd, Range{0.1, 1e9},
          "the mesh ends where the standard deviation of depth exceeds this many GSD: ragged rims, and guesses");
    visit("white_percentile", self.white_percentile, Range{1, 100},
          "intensity percentile that becomes white in the vertex colors");
    visit("dem_pixel", self.dem_pixel, Range{1e-9, 1e9},
          "pixel of the elevation model in the station's unit; auto = GSD x subsample");
    visit("glb_triangles", self.glb_triangles, Range{100, 1e9},
          "surface.glb takes every n-th pixel as a vertex, n so large that it has about as many triangles at most");
    visit("glb_texture_px", self.glb_texture_px, Range{16, 16384},
          "longest side of the texture in surface.glb; larger images are reduced by averaging");
  }
};

/// Triangle mesh of the fused depth in the world frame, station unit, counter-clockwise seen from the camera.
///
/// Every cell of the pixel grid becomes two triangles (split along its shorter diagonal in space), one, or none: a
/// triangle needs three finite depths whose standard deviations do not exceed max_sigma_gsd GSD (depth / focal), must
/// not be flatter to the ray than max_incidence_deg, and must not cross a depth discontinuity. Two neighboring pixels
/// are separated by one if their depth step exceeds min_step_gsd GSD (depth / focal) and step_ratio times the larger of
/// the two steps that continue it on either side, so that steep relief, whose neighbors are steep too, stays whole, and
/// an occlusion edge does not. With subsample > 1 these tests still see every pixel. Vertices without a triangle are
/// dropped.
///
/// Vertex normals are the fused normals (or differences of the depth if the surface has none). `color` is linear, 1 or
/// 3 channels of the surface's size, or empty for a mesh without colors; one factor for all channels takes its
/// white_percentile (of the values on the surface) to white, and values are sRGB-encoded to 8 bit.
///
/// Throws an input error if rasters disagree in size or options are out of range, a data error if no triangle is left.
TriangleMesh mesh_from_depth(const FusedSurface& surface, const Image<float>& color, const SurfaceOptions& options,
                             const Context& context);

/// The same mesh strip by strip, for surfaces whose mesh would be larger than their maps. Both rasters must outlive it.
MeshInStrips mesh_in_strips(const FusedSurface& surface, const Image<float>& color, const SurfaceOptions& options,
                            const Context& context);

/// The subsample with which a surface whose mesh has `triangles` at options.subsample has `limit` or about as many; at
/// least options.subsample, at most the option's bound.
int subsample_for(std::size_t triangles, int limit, const SurfaceOptions& options);

}  // namespace malus
