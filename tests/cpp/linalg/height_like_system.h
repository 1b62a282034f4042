#pragma once

#include <cmath>

#include "malus/linalg/grid_system_internal.h"

namespace malus {

/// Adds the rows of a height problem (Eq 9 and 11, central differences) to a cleared system: at every pixel one row for
/// the height's derivative across the azimuth, one for that along the light, and second differences of small weight.
/// The azimuth turns across the raster and the weights of the rows vary a hundredfold, so that the system is
/// anisotropic in every direction somewhere. Only second differences couple pixels of different parity.
inline void add_height_like_rows(GridSystem& system) {
  const PixelIndex& pixels = system.pixels();
  constexpr double smoothness = 0.05, light_u = 0.4, light_v = 0.3;
  for (int i = 0; i < pixels.count(); ++i) {
    const int u = pixels.u(i), v = pixels.v(i);
    const auto derivative = [&](int du, int dv, int* unknowns, double* coefficients) {
      const int after = pixels.at(u + du, v + dv), before = pixels.at(u - du, v - dv);
      if (after < 0 && before < 0) return false;
      const double scale = after >= 0 && before >= 0 ? 0.5 : 1;
      unknowns[0] = after >= 0 ? after : i, coefficients[0] = scale;
      unknowns[1] = before >= 0 ? before : i, coefficients[1] = -scale;
      return true;
    };
    int unknowns[4];
    double along[4];
    if (derivative(1, 0, unknowns, along) && derivative(0, 1, unknowns + 2, along + 2)) {
      const double x = 0.02 * u, y = 0.02 * v;
      const double azimuth = 3 * std::sin(x) * std::cos(0.7 * y) + 0.5 * std::sin(7 * x + 5 * y);
      const double slope = 0.1 + 0.9 * std::pow(std::sin(0.31 * x + 1.3 * y), 2), weight = slope * slope;
      const auto add = [&](double p, double q, double target, double w) {
        // Both derivatives may refer to the same pixel: sum up its coefficients.
        int distinct[4];
        double coefficients[4];
        int count = 0;
        for (int k = 0; k < 4; ++k) {
          const double coefficient = (k < 2 ? p : q) * along[k];
          int at = 0;
          while (at < count && distinct[at] != unknowns[k]) ++at;
          if (at == count) distinct[count] = unknowns[k], coefficients[count++] = 0;
          coefficients[at] += coefficient;
        }
        system.add_row(distinct, coefficients, count, target, w);
      };
      add(std::sin(azimuth), -std::cos(azimuth), 0, weight);
      add(light_u, light_v, slope * (light_u * std::cos(azimuth) + light_v * std::sin(azimuth)), 1);
    }
    for (const auto& [du, dv] : {std::pair{1, 0}, {0, 1}}) {
      const int before = pixels.at(u - du, v - dv), after = pixels.at(u + du, v + dv);
      if (before < 0 || after < 0) continue;
      const int row[] = {before, i, after};
      const double second[] = {1, -2, 1};
      system.add_row(row, second, 3, 0, smoothness * smoothness);
    }
  }
}

}  // namespace malus
