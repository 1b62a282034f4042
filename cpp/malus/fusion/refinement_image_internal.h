#pragma once

#include <memory>

#include "malus/core/context.h"
#include "malus/fusion/refinement_field_internal.h"
#include "malus/polarization/polarization_state.h"
#include "malus/prior/depth_prior.h"

namespace malus {

/// What is known of a pixel of the object and of its upper left node before anything is refined; s0 to variance only
/// where it is usable.
struct PixelData {
  double x_prior = 0;     ///< of the node [GSD]
  float prior_sigma = 1;  ///< of the node [GSD]
  float s0 = 0, s1 = 0, s2 = 0, variance = 0;
};

/// Where a RefinementImage has its pixels' data from.
class PixelSource {
 public:
  virtual ~PixelSource() = default;
  virtual PixelData at(int u, int v) const = 0;
};

/// The image that is refined. A field of it takes 60 bytes a pixel and its weights while they are made as much again;
/// only what the rounds change is kept of all pixels, and a field is made of the part that is worked on.
struct RefinementImage : SurfaceEstimate {
  Mask pixels;  ///< of the object, in the nodes' raster
  std::shared_ptr<const PixelSource> source;

  /// Field of a part at the present surface, without weights. The part's borders must be multiples of the prior blocks,
  /// or the image's.
  RefinementField part(const PixelRect& rect, const Context& context) const;
};

/// Image of the pixels where the prior has a depth and the polarization state knows the object, at the prior's surface;
/// both must outlive it. Throws an input error if the sizes differ, a data error if no pixel is left.
RefinementImage make_image(const PolarizationState& state, const DepthPrior& prior, const Context& context);

/// Rows that are worked on together.
struct RowRange {
  int begin = 0, end = 0;
};

/// Field of some rows with so many around them, as far as there are any.
struct StripField {
  RefinementField field;
  int first_row = 0;  ///< of the field, in the image
  RowRange rows;      ///< that were asked for, in the field
};
StripField strip_field(const RefinementImage& image, RowRange rows, int margin, const Context& context);

}  // namespace malus
