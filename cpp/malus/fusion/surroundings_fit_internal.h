#pragma once

#include <complex>
#include <span>
#include <vector>

#include "malus/core/context.h"
#include "malus/fusion/reflection_sample_internal.h"
#include "malus/fusion/surroundings_internal.h"

namespace malus {

/// Surroundings fitted to the Stokes vectors at known slopes, and how well they explain them.
struct SurroundingsFit {
  Surroundings surroundings;
  double cost = 0;             ///< of (s1, s2): mean of ln(1 + r² / 4)
  double intensity_error = 0;  ///< median of |s0 − m0| / s0
};

/// The material that mirrors the surroundings.
struct MirrorMaterial {
  std::complex<double> index = 1.5;  ///< imaginary part > 0 for a metal
  double intensity_error = 0.15;     ///< of a metal: relative standard deviation of s0

  bool is_metal() const { return index.imag() > 0; }
};

/// Fits the radiance of all cells for each of the `tried` finishes and returns the fit of lowest cost. With the body
/// light substituted from the measured s0, d = s0 − m0, the Stokes residual is linear in the radiances: robust
/// non-negative least squares. A metal has no body light: there the measured s0 is a third equation, s0 = m0. `start`:
/// approximate radiance, or empty.
SurroundingsFit fit_surroundings(const std::vector<ReflectionSample>& samples, const MirrorMaterial& material,
                                 std::span<const Finishes> tried, const Image<float>& start, const Context& context);

/// RMS error of index_of_body on random objects for which it differed from the supposed index.
inline constexpr double index_of_body_sigma = 0.08;

/// Refractive index in [1.3, 2.0] with which the surroundings explain the Stokes vectors best; it alone determines the
/// polarization of the body light. Returns `supposed` unless another index in that range is clearly better. Slopes that
/// are too small give an index that is too large.
double index_of_body(const std::vector<ReflectionSample>& samples, double supposed, const Finishes& finishes,
                     const Context& context);

}  // namespace malus
