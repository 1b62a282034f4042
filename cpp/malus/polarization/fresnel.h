#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>

namespace malus {

// Fresnel optics of a smooth dielectric of refractive index eta in air. Angles are zeniths: between the normal and the
// viewing ray, [0, π/2]. Everything is closed form, two square roots at most, so that no table is needed per pixel. The
// templates also take automatic-differentiation scalars. They are written in sin²θ because all these functions are
// smooth in sin²θ, frontal view included.

/// Reflected share of the power polarized perpendicular (s) and parallel (p) to the plane of incidence.
template <class T>
struct Reflectance {
  T s;
  T p;
};

/// Fresnel power reflectances for a ray in air, given sin² of its angle of incidence.
template <class T>
Reflectance<T> fresnel_reflectance(const T& sin2, double eta) {
  using std::sqrt;
  const T cosine = sqrt(1.0 - sin2);
  const T q = sqrt(eta * eta - sin2);  // eta times the cosine of the refracted ray
  const T s = (cosine - q) / (cosine + q);
  const T p = (eta * eta * cosine - q) / (eta * eta * cosine + q);
  return {s * s, p * p};
}

/// Degree of polarization of diffuse reflection over sin²θ; finite at θ = 0. Eq 6 divided by sin²θ.
template <class T>
T diffuse_degree_over_sin2(const T& sin2, double eta) {
  using std::sqrt;
  const double sum = eta + 1 / eta, difference = eta - 1 / eta;
  return difference * difference /
         (2 + 2 * eta * eta - sum * sum * sin2 + 4.0 * sqrt(1.0 - sin2) * sqrt(eta * eta - sin2));
}

/// Degree of polarization of specular reflection over sin²θ; finite at θ = 0. Eq 8 divided by sin²θ.
template <class T>
T specular_degree_over_sin2(const T& sin2, double eta) {
  using std::sqrt;
  const double eta2 = eta * eta;
  return 2.0 * sqrt(1.0 - sin2) * sqrt(eta2 - sin2) / (eta2 - (1 + eta2) * sin2 + 2.0 * sin2 * sin2);
}

/// Degree of polarization of diffuse reflection at this zenith (Eq 6): light that left the body through its surface.
inline double diffuse_degree(double zenith_rad, double eta) {
  const double sin2 = std::sin(zenith_rad) * std::sin(zenith_rad);
  return sin2 * diffuse_degree_over_sin2(sin2, eta);
}

/// Degree of polarization of specular reflection of unpolarized light at this zenith (Eq 8); 1 at Brewster's angle.
inline double specular_degree(double zenith_rad, double eta) {
  const double sin2 = std::sin(zenith_rad) * std::sin(zenith_rad);
  return sin2 * specular_degree_over_sin2(sin2, eta);
}

/// Brewster's angle, where the specular degree is 1.
inline double brewster_angle(double eta) {
  return std::atan(eta);
}

/// Largest degree that Eq 6 can give, at grazing view: 0.385 for eta = 1.5.
inline double largest_diffuse_degree(double eta) {
  const double sum = eta + 1 / eta, difference = eta - 1 / eta;
  return difference * difference / (2 + 2 * eta * eta - sum * sum);
}

/// A zenith computed from a degree of polarization.
struct ZenithFromDegree {
  double zenith_rad = 0;
  bool clamped = false;  ///< the degree was below 0 or above the model's largest
};

/// Zenith of diffuse reflection of this degree: inverse of Eq 6. Eq 7's value f is cos θ; this is the same expression
/// rearranged into sin²θ = 1 − f², which loses no digits at small degrees. Above the largest diffuse degree Eq 7 turns
/// back, so the degree is clamped to it and `clamped` is set.
inline ZenithFromDegree diffuse_zenith(double degree, double eta) {
  const double largest = largest_diffuse_degree(eta);
  const double r = std::clamp(degree, 0.0, largest);
  const double eta2 = eta * eta;
  const double numerator = 2 * eta2 * r * ((1 + eta2) * (1 + r) + 2 * eta * std::sqrt((1 - r) * (1 + r)));
  const double denominator =
      (eta2 * eta2 + 6 * eta2 + 1) * r * r + 2 * (1 + eta2) * (1 + eta2) * r + (eta2 - 1) * (eta2 - 1);
  const double sine = std::sqrt(std::min(numerator / denominator, 1.0));
  return {degree >= largest ? std::numbers::pi / 2 : std::asin(sine), degree < 0 || degree > largest};
}

/// Side of Brewster's angle: each specular degree has one zenith on either side (0.3 at eta = 1.5: 26.4° and 82.3°).
enum class SpecularBranch { below_brewster, above_brewster };

/// Zenith of specular reflection of this degree on one side of Brewster's angle: closed-form inverse of Eq 8. From the
/// ratio of the Fresnel reflectances, k = cos(θ + θt) / cos(θ − θt) with k² = Rp / Rs = (1 − ρ) / (1 + ρ), follows
/// t = tan θ tan θt = (1 − k) / (1 + k) and with Snell's law a quadratic in sin²θ. The degree is clamped to [0, 1].
inline ZenithFromDegree specular_zenith(double degree, double eta, SpecularBranch branch) {
  const double r = std::clamp(degree, 0.0, 1.0);
  const double k = std::sqrt((1 - r) / (1 + r));
  const double below = 2 * r / ((1 + r) * (1 + k) * (1 + k));  // t below Brewster's angle; beyond it 1 / t
  const double eta2 = eta * eta;
  const double sum = 1 + eta2, t2 = below * below;
  const double sin2 = branch == SpecularBranch::below_brewster
                          ? 2 * below * eta2 / (below * sum + std::sqrt(t2 * sum * sum + 4 * (1 - t2) * eta2))
                          : 2 * eta2 / (sum + std::sqrt(sum * sum - 4 * (1 - t2) * eta2));
  const double sine = std::sqrt(std::min(sin2, 1.0));
  return {std::asin(sine), degree < 0 || degree > 1};
}

}  // namespace malus
