#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"
#include "malus/options/fusion_options.h"

namespace malus {

/// Options for the residuals' weights: those of the refinement, and of one round.
struct WeightOptions : RefineOptions {
  double specular_widening = 1;  ///< factor on robust_scale in specular regions
  double regional_sigma_px = 0;  ///< 0 = no regional down-weighting
  int binning = 1;               ///< pixels of the station's image along a side of one pixel of the field
};

/// Summary of the Stokes residuals at the current surface.
struct FitQuality {
  double median_residual =
      0;  ///< of |(s1, s2) − model| / σ / √2 over the added pixels; about 0.8 when only noise is left
  double robust_cost = 0;  ///< mean of ln(1 + r² / 4)
};

/// Stokes residuals of a field's pixels at its surface; NaN where polarization is not used.
struct PixelResiduals {
  Image<float> squared;     ///< in units of their variance, mean of both components
  Image<float> log_albedo;  ///< ln(body / shading), diffuse regions
};

/// Radius of the neighborhood that determines a pixel's weights [px], in whole prior blocks.
inline constexpr int weights_reach_px = 24;

/// Recomputes the robust weights of all residuals, and ln of the body light, at the current surface, except the weight
/// of albedo changes, which needs the whole image.
PixelResiduals update_weights(RefinementField& field, const WeightOptions& options, const Context& context);

/// Summary of an image's residuals, collected part by part.
class ResidualSummary {
 public:
  /// `usable` are the image's pixels with residuals.
  explicit ResidualSummary(const Mask& usable);
  /// Adds some rows of a part; `first_row` is the part's first row in the image.
  void add(const PixelResiduals& part, RowRange rows, int first_row);
  FitQuality quality();
  /// Weight of changes of ln albedo.
  double albedo_weight(const WeightOptions& options);

 private:
  Size image_;
  double share_;  ///< of pixels that are sampled for medians
  double cost_ = 0, count_ = 0;
  std::vector<float> squared_, albedo_steps_;
};

/// Squared residual of a pixel's (s1, s2) at the current surface, in units of their variance; 0 where polarization is
/// not used.
double squared_residual(const RefinementField& field, int u, int v);

/// Weight, 0 … 1, that the robust loss leaves to a pixel's Stokes residuals at the current surface; 0 where
/// polarization is not used.
double stokes_weight(const RefinementField& field, int u, int v);

}  // namespace malus
