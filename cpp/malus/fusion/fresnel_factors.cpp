#include <algorithm>
#include <cmath>

#include "malus/fusion/fresnel_factors_internal.h"

namespace malus {

namespace {

constexpr double largest_tan2 = 1458.0;  // 88.5°

}  // namespace

FresnelFactors fresnel_factors(double tan2, double eta) {
  const bool clamped = tan2 > largest_tan2;
  const double g = std::clamp(tan2, 0.0, largest_tan2);
  const double eta2 = eta * eta;
  const double c2 = 1 / (1 + g), s = 1 - c2;  // cos² and sin² of the zenith
  const double c = std::sqrt(c2), q = std::sqrt(eta2 - s);
  const double c_slope = -0.5 / c, q_slope = -0.5 / q;  // by s
  const double mixed = q * c_slope - c * q_slope;
  const double sum_s = c + q, sum_p = eta2 * c + q;
  const double a = (c - q) / sum_s, b = (eta2 * c - q) / sum_p;  // Fresnel amplitudes
  const double s_slope = clamped ? 0.0 : c2 * c2;                // ds / dg

  FresnelFactors f;
  f.reflectance = 0.5 * (a * a + b * b);
  f.reflectance_slope = s_slope * (a * 2 * mixed / (sum_s * sum_s) + b * 2 * eta2 * mixed / (sum_p * sum_p));

  const double sum = eta + 1 / eta, difference = eta - 1 / eta;
  const double denominator = 2 + 2 * eta2 - sum * sum * s + 4 * c * q;
  const double denominator_slope = -sum * sum + 4 * (c_slope * q + c * q_slope);
  f.diffuse = difference * difference * c2 / denominator;
  f.diffuse_slope = s_slope * f.diffuse * (-1 / c2 - denominator_slope / denominator);

  // (Rs − Rp) / 2 = (a − b)(a + b) / 2 without cancellation.
  const double product = sum_s * sum_p;
  const double product_slope = (c_slope + q_slope) * sum_p + sum_s * (eta2 * c_slope + q_slope);
  f.specular = 2 * (eta2 - 1) * (eta2 - 1) * c * c2 * q / (product * product);
  f.specular_slope = s_slope * f.specular * (3 * c_slope / c + q_slope / q - 2 * product_slope / product);
  return f;
}

MirrorFactors mirror_factors(double tan2, std::complex<double> index) {
  if (index.imag() == 0) {
    MirrorFactors factors;
    mirrored_by_dielectric(1 / std::sqrt(1 + std::min(tan2, largest_tan2)), index.real(), factors.reflectance,
                           factors.specular);
    return factors;
  }
  const double c2 = 1 / (1 + tan2), s = 1 - c2, c = std::sqrt(c2);
  // With a + i b = √(index² − s) and |a + i b|² = norm.
  const std::complex<double> root = std::sqrt(index * index - s);
  const double a = root.real(), norm = std::norm(root);
  const double across = (norm + c2 - 2 * a * c) / (norm + c2 + 2 * a * c);  // Rs
  const double sum = c2 * norm + s * s + 2 * a * c * s;
  const double along = across * (1 - 4 * a * c * s / sum);  // Rp
  return {0.5 * (across + along), across * 2 * a * c * c2 / sum};
}

}  // namespace malus
