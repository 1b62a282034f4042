#pragma once

#include "malus/core/cell_values_internal.h"
#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// How much of the measured polarization the reflection model explains at the *prior's* slopes, region by region.
///
/// The residual after the refinement is weak evidence for its surface: two slopes per pixel can fit two Stokes
/// components with any model. The prior's slopes were not fitted to the polarization. They lack detail, but over cells
/// of 16 px they are accurate enough that a correct model explains most of the mean (s1, s2), and a wrong one does not.
/// The share of a cell is 1 − 2 r² / (r² + t²), with t its mean Stokes vector and r the residual of t at the prior's
/// slopes: 1 = all is explained, 0 = nothing, −1 = the prediction is far worse than none. A model with a parameter for
/// every direction explains any polarization on a nearly flat object. With `beyond_a_plane`, t is therefore the
/// residual at the slopes of a plane with the object's mean normal. Cells are pooled by a Gaussian of two cells.
class ExplainedPolarization {
 public:
  /// `mean_normal` is the object's, camera frame.
  ExplainedPolarization(Size image, const Eigen::Vector3d& mean_normal);

  /// Adds some rows of a part. The part has the prior's surface and the weights at it.
  void add(const RefinementField& part, RowRange rows, int first_row, const Context& context);

  /// Pooled shares from −1 to 1, one per cell; 0 far from usable pixels.
  Image<float> shares(bool beyond_a_plane, const Context& context) const;

  static constexpr int cell_px = 16;

 private:
  struct Cell {
    /// Sums of (s1, s2): measured, and predicted at the prior's and at the plane's slopes.
    Eigen::Vector2d measured = Eigen::Vector2d::Zero(), model = measured, plane = measured;
    int pixels = 0;
  };
  Image<Cell> cells_;
  Eigen::Vector3d mean_normal_;
};

/// How much of the polarization the reflection model explains at the *refined* surface, cell by cell of 16 px.
///
/// Each pixel has two Stokes components but only one depth, so that a surface cannot take up all errors of a model. The
/// share of a cell is 1 − median |r| / median |s| over its pixels; of a cell that two parts share, the mean of both
/// parts' shares. A share near one means that the model held while the surface moved. A share of a half means that the
/// model is wrong and the slopes took up what they could of its errors.
class ExplainedByResult {
 public:
  explicit ExplainedByResult(Size image);

  /// Adds some rows of a part. The part has the surface to be judged and the weights at it.
  void add(const RefinementField& part, RowRange rows, int first_row, const Context& context);

  /// Shares up to 1, one per cell; cells without usable pixels follow their neighbors.
  Image<float> shares(const Context& context) const;

 private:
  Image<float> shares_, pixels_;  ///< of each cell; pixels: how many its share is the mean of
};

/// Adds the low frequencies (Gaussian of `length_px`) of prior − surface to the surface. Errors of a reflection model
/// add up over a distance, while the noise of the prior's points averages out: beyond the distance where both are
/// equal, the prior is more accurate. The prior is weighted by its inverse variance.
void anchor_to_prior(RefinementImage& image, const Image<double>& x_prior, double length_px, const Context& context);

/// Distance of the surface from the prior in the prior's standard deviations, RMS over cells of 16 px. A surface that
/// is better than the prior differs from it by the prior's errors: by about one standard deviation.
Image<float> deviations_from_prior(const RefinementImage& image, const Image<double>& x_prior, const Context& context);

}  // namespace malus
