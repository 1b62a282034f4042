#pragma once

#include "malus/core/cell_values_internal.h"
#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// How much of the measured polarization the reflection model explains at the *prior's* slopes, region by region.
///
/// The residual after the refinement says little about whether its surface is true: two slopes a pixel fit two Stokes
/// components of any model. The prior's slopes were not made to fit. They lack detail, but over cells of 16 px they are
/// known well enough that a model that holds explains most of the mean (s1, s2), and a wrong one does not. Each cell
/// counts by 1 − 2 r² / (r² + t²), with r what the model leaves of its mean Stokes vector at the prior's slopes and t
/// all of it: 1 = all is explained, 0 = nothing, −1 = far less than nothing. A model with many parameters has one for
/// every direction: on a nearly flat object it explains any polarization. Then t is what it leaves at the slopes of a
/// plane with the object's mean normal. Cells are pooled by a Gaussian of two cells.
class ExplainedPolarization {
 public:
  /// The mean normal is the object's, camera frame.
  ExplainedPolarization(Size image, const Eigen::Vector3d& mean_normal);

  /// Adds some of a part's rows. The part is at the prior's surface, and its weights are of it.
  void add(const RefinementField& part, RowRange rows, int first_row, const Context& context);

  /// Pooled shares from −1 to 1, a cell each; 0 far from usable pixels.
  Image<float> shares(bool beyond_a_plane, const Context& context) const;

  static constexpr int cell_px = 16;

 private:
  struct Cell {
    double s1 = 0, s2 = 0;              ///< measured, summed
    double model_s1 = 0, model_s2 = 0;  ///< predicted at the prior's slopes
    double plane_s1 = 0, plane_s2 = 0;  ///< predicted at the plane's
    int pixels = 0;
  };
  Image<Cell> cells_;
  Eigen::Vector3d mean_normal_;
};

/// How much of the polarization the reflection model explains at the *refined* surface, cell by cell of 16 px.
///
/// Each pixel has two Stokes components and one depth of its own, so that a surface cannot take up all errors of a
/// model. A share of 1 − median |r| / median |s| of a cell's pixels near one means that the model held while the
/// surface moved; half of the polarization left over means that the slopes took up what they could of a wrong one.
class ExplainedByResult {
 public:
  explicit ExplainedByResult(Size image);

  /// Adds some of a part's rows. The part is at the refined surface, and its weights are of it.
  void add(const RefinementField& part, RowRange rows, int first_row, const Context& context);

  /// Shares up to 1, a cell each; cells without usable pixels follow those around them.
  Image<float> shares(const Context& context) const;

 private:
  Image<float> shares_, weights_;
};

/// Adds to the surface the low frequencies (Gaussian of `length_px`) of what it lacks of the prior. Errors of a
/// reflection model add up over a distance, the noise of a prior's points averages out over it: beyond the distance
/// where both are equal the prior is the better one. The prior counts by its variance.
void anchor_to_prior(RefinementImage& image, const Image<double>& x_prior, double length_px, const Context& context);

/// How far the surface is from the prior in the prior's standard deviations, RMS cell by cell of 16 px. A surface that
/// is better than the prior's differs from it by the prior's errors: by one of them.
Image<float> deviations_from_prior(const RefinementImage& image, const Image<double>& x_prior, const Context& context);

}  // namespace malus
