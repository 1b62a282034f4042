#pragma once

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

/// Values at g = tan²(zenith) ≥ 0 for a refractive index n + i k (Born and Wolf, Principles of Optics, section 14.2).
MirrorFactors mirror_factors(double tan2, std::complex<double> index);

}  // namespace malus
