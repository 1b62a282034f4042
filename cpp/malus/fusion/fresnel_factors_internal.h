#pragma once

#include <cmath>
#include <complex>

namespace malus {

/// Fresnel quantities of a smooth dielectric as functions of g = tan²(zenith), each with its derivative by g. Divided
/// by g they are finite and smooth at normal incidence, where slopes of a surface have no direction.
struct FresnelFactors {
  double reflectance = 0;  ///< F = (Rs + Rp) / 2
  double diffuse = 0;      ///< diffuse degree of polarization (Eq 6) / g
  double specular = 0;     ///< (Rs − Rp) / 2 / g, the polarized part of a mirror reflection
  double reflectance_slope = 0;
  double diffuse_slope = 0;
  double specular_slope = 0;
};

/// Values at g = tan²(zenith) ≥ 0 for a refractive index eta > 1. Beyond 88.5° the values at 88.5° are returned.
FresnelFactors fresnel_factors(double tan2, double eta);

/// Mirror reflection of a smooth dielectric or (imaginary part > 0) metal.
struct MirrorFactors {
  double reflectance = 0;  ///< F = (Rs + Rp) / 2
  double specular = 0;     ///< (Rs − Rp) / 2 / g
};

/// The same of a dielectric of refractive index eta for cosines of the zenith; of numbers, or of Eigen's arrays.
template <class Values, class Number>
void mirrored_by_dielectric(const Values& cosine, Number eta, Values& reflectance, Values& specular) {
  using std::sqrt;
  const Number eta2 = eta * eta, contrast = eta2 - 1;
  const Values c2 = cosine * cosine, q = sqrt(c2 + contrast);
  const Values sum_s = cosine + q, sum_p = eta2 * cosine + q, product = sum_s * sum_p;
  const Values a = (cosine - q) / sum_s, b = (eta2 * cosine - q) / sum_p;  // Fresnel amplitudes
  reflectance = (a * a + b * b) / 2;
  specular = 2 * contrast * contrast * cosine * c2 * q / (product * product);
}

/// Values at g = tan²(zenith) ≥ 0 for a refractive index n + i k (Born and Wolf, Principles of Optics, section 14.2).
MirrorFactors mirror_factors(double tan2, std::complex<double> index);

}  // namespace malus
