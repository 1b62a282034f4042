#pragma once

#include <Eigen/Core>
#include <limits>
#include <vector>

#include "malus/core/context.h"
#include "malus/fusion/refine_internal.h"
#include "malus/fusion/refinement_image_internal.h"
#include "malus/fusion/refinement_weights_internal.h"
#include "malus/fusion/surface_evidence_internal.h"
#include "malus/fusion/surroundings_course_internal.h"
#include "malus/fusion/tile_solver_internal.h"

namespace malus {

/// What the parts of the refinement of one image share: the choice of the model, the rounds, the evidence and the
/// resulting surface. Image, options, report and context must outlive it.
struct Refinement {
  Refinement(RefinementImage& image, const RefineOptions& options, RefineReport& report, const Context& context,
             int binning = 1);

  RefinementImage& image;
  const RefineOptions& options;
  RefineReport& report;
  const Context& context;
  int binning;  ///< pixels of the station's image along a side of one pixel of this image
  std::vector<Tile> tiles;
  std::vector<TileStrip> strips;
  Eigen::Vector3d mean_normal;  ///< of the surface that the refinement starts from
  MapCourse map;
  bool is_mirror_known = false;  ///< keep the specular light as fitted at the prior's slopes
  double lobe_gain = 0;          ///< relative decrease of the robust cost by the highlight
  double same_normals_px = 0;    ///< distance_of_same_normals of the prior
  /// Longest wave of the surface that cannot be confused with a different map of the surroundings [px].
  double longest_wave_px = std::numeric_limits<double>::infinity();

  /// Fits the parameters that all pixels share at the current surface.
  void fit_reflection();

  /// Options for the weights of a round; `regional` allows to weigh whole regions less.
  WeightOptions weights(double widening, bool regional) const;

  /// Field of some rows with its weights. Adds the residuals to the summary unless it is null.
  StripField weighted_strip(RowRange rows, int margin, const WeightOptions& options, ResidualSummary* summary) const;

  /// How much of the polarization the reflection model explains at the prior's slopes.
  ExplainedPolarization explained() const;

  /// How much of the polarization the reflection model explains at the current surface, or at the prior's: shares of
  /// the cells.
  Image<float> explained_by_result(bool at_prior) const;

  double mean_over_object(const Image<float>& cells) const;

  /// Adds all strips to a sum, with the weights at the current surface or at the prior's.
  template <class Sum>
  void add_strips(bool at_prior, Sum& sum) const {
    for (const TileStrip& tiles_of_strip : strips) {
      StripField strip = strip_field(image, tiles_of_strip.rows, whole_blocks(weights_reach_px), context);
      if (at_prior) std::swap(strip.field.x, strip.field.x_prior);
      update_weights(strip.field, weights(1, false), context);
      sum.add(strip.field, strip.rows, strip.first_row, context);
    }
  }
};

/// Whether most of the object has the polarization of a mirror image that is too weak for a dielectric. A dielectric
/// would have to be nearly white for its body light to dilute the polarization that much.
bool looks_like_metal(const RefinementImage& image);

/// 0 below `least`, 1 from `enough` on, linear between.
double ramp(double value, double least, double enough);

}  // namespace malus
