#pragma once

#include <complex>
#include <span>
#include <vector>

#include "malus/core/context.h"
#include "malus/fusion/reflection_fit_internal.h"
#include "malus/fusion/surroundings_internal.h"

namespace malus {

/// How well surroundings explain the Stokes vectors at known slopes.
struct SurroundingsFit {
  Surroundings surroundings;
  double cost = 0;             ///< of (s1, s2): mean of ln(1 + r² / 4)
  double intensity_error = 0;  ///< median of |s0 − m0| / s0
};

/// What mirrors the surroundings.
struct MirrorMaterial {
  std::complex<double> index = 1.5;  ///< a metal's has an imaginary part > 0
  double intensity_error = 0.15;     ///< of a metal: standard deviation of its s0, as a share of it

  bool is_metal() const { return index.imag() > 0; }
};

/// Roughness of the facets of most pixels, and of those with the other finish, as of glaze and bare clay; 0 = no such.
struct Finishes {
  double usual = 0.1, other = 0;
};

/// Fits the radiance of all cells for each of these finishes and keeps the cheapest. With the light from the body put
/// in from the measured s0, d = s0 − m0, the Stokes residual is linear in the radiances: robust non-negative least
/// squares. A metal has no light from a body: there the measured s0 is a third equation, s0 = m0. `start`: radiance
/// that is about right, or empty.
SurroundingsFit fit_surroundings(const std::vector<ReflectionSample>& samples, const MirrorMaterial& material,
                                 std::span<const Finishes> tried, const Image<float>& start, const Context& context);

/// RMS error of the index below, of random objects where it was not the supposed one.
inline constexpr double index_of_body_sigma = 0.08;

/// Refractive index in [1.3, 2.0] for which surroundings explain the Stokes vectors best: the light from the body is
/// polarized by it alone. `supposed`, unless another one within that range is clearly better. Slopes of the samples
/// that are too small give one that is too large.
double index_of_body(const std::vector<ReflectionSample>& samples, double supposed, const Finishes& finishes,
                     const Context& context);

}  // namespace malus
