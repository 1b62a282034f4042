#pragma once

#include <functional>

#include "malus/core/context.h"
#include "malus/core/parallel_internal.h"
#include "malus/fusion/refinement_field_internal.h"
#include "malus/polarization/polarization_state.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// Input data of a pixel of the object and of its upper left node; s0 to variance only where the pixel is usable.
struct PixelData {
  double x_prior = 0;     ///< of the node [GSD]
  float prior_sigma = 1;  ///< of the node [GSD]
  float s0 = 0, s1 = 0, s2 = 0, variance = 0;
};

/// The image that is refined. A field takes 60 bytes per pixel, and as much again while its weights are computed. Only
/// the data that change from round to round are therefore kept for all pixels; a field is made for one part at a time.
struct RefinementImage : SurfaceEstimate {
  Mask pixels;  ///< of the object, in the nodes' raster
  std::function<PixelData(int u, int v)> source;
  /// The images' noise as the sinusoids' residuals show it, as a share of the variance that is stated or assumed, at
  /// most 1; 0 if three images show none.
  double noise_share = 1;

  /// Field of a part with the present surface, without weights. The part's borders must be multiples of the prior
  /// blocks, or the image's.
  RefinementField part(const PixelRect& rect, const Context& context) const;
  /// The prior at all nodes of the object, NaN elsewhere.
  Image<double> prior_surface(const Context& context) const;
};

/// Image of the object's pixels where the prior has a depth, with the prior's surface; `state` and `prior` must outlive
/// it. Throws an input error if the sizes differ, a data error if no pixel is left.
RefinementImage make_image(const PolarizationState& state, const DepthPrior& prior, const Context& context);

/// Rows that are processed together.
struct RowRange {
  int begin = 0, end = 0;
};

/// Field of some rows and of up to `margin` rows on either side.
struct StripField {
  RefinementField field;
  int first_row = 0;  ///< the field's first row, in the image
  RowRange rows;      ///< the requested rows, in the field
};
StripField strip_field(const RefinementImage& image, RowRange rows, int margin, const Context& context);

/// Calls body(column, row, pixels) for every cell with some of the rows of a part of the image, on the context's
/// threads: column and row count from the image's first cell, and `pixels` are those of the rows, in the part.
/// `first_row`: the part's first row, in the image.
template <class Body>
void for_each_cell(int cell_px, int width, RowRange rows, int first_row, const Context& context, Body&& body) {
  const int first = (first_row + rows.begin) / cell_px, last = (first_row + rows.end - 1) / cell_px;
  const PixelRect in_rows{0, rows.begin, width, rows.end};
  const Size cells{cells_over({width, 1}, cell_px).width, last - first + 1};
  parallel_pixels(context, cells, [&](int column, int i) {
    const int u0 = column * cell_px, v0 = (first + i) * cell_px - first_row;
    body(column, first + i, in_rows.intersected({u0, v0, u0 + cell_px, v0 + cell_px}));
  });
}

}  // namespace malus
