#pragma once

#include "malus/core/context.h"
#include "malus/fusion/refinement_field.h"

namespace malus {

/// How much each residual counts; see RefineOptions for the meaning of the numbers.
struct WeightOptions {
  double robust_scale = 2.5;
  double specular_widening = 1;  ///< factor on robust_scale in specular regions
  double relative_error = 0.002;
  double slope_error = 0.03;
  double prior_weight = 5;
  double good_prior_weight = 12;
  double prior_robust_gsd = 2;
  double albedo_weight = 10;
  double albedo_contrast = 0.04;
  double regional_sigma_px = 0;  ///< 0 = no regional down-weighting
};

/// What the Stokes residuals look like at the current surface.
struct FitQuality {
  double median_residual = 0;  ///< of |(s1, s2) − model| / σ / √2 over usable pixels; about 0.8 when only noise is left
  double robust_cost = 0;  ///< mean of ln(1 + r² / 4)
};

/// Recomputes the robust weights of all residuals, and ln of the body light, at the current surface.
FitQuality update_weights(RefinementField& field, const WeightOptions& options, const Context& context);

/// Weight, 0 … 1, that the robust loss leaves to a pixel's Stokes residuals at the current surface; 0 where
/// polarization is not used.
double stokes_weight(const RefinementField& field, int u, int v);

}  // namespace malus
