// Uses an installed malus from outside its tree: a known sinusoid through the fit, and the main path's headers.
#include <malus/core/version.h>
#include <malus/polarization/decompose.h>
#include <malus/station/reconstruct.h>

#include <cmath>
#include <cstdio>
#include <numbers>
#include <vector>

int main() {
  const double phase = 0.7, degree = 0.25;
  std::vector<malus::Image<float>> images;
  std::vector<double> angles;
  for (int k = 0; k < 6; ++k) {
    angles.push_back(k * std::numbers::pi / 6);
    images.emplace_back(malus::Size{8, 8}, 1,
                        static_cast<float>(0.4 * (1 + degree * std::cos(2 * (angles.back() - phase)))));
  }
  const malus::Mask mask({8, 8}, 1, 255);
  const auto state = malus::decompose(images, angles, {}, mask, {}, {}, {});
  const bool right = std::abs(state.rho(3, 3) - degree) < 1e-5 && std::abs(state.phi(3, 3) - phase) < 1e-5;
  try {
    malus::Station::load("no such station.toml");
    return 1;
  } catch (const malus::Error& error) {
    std::printf("malus %s: degree %.4f, phase %.4f, %zu steps, %s\n", malus::version, state.rho(3, 3), state.phi(3, 3),
                malus::step_names().size(), error.what());
    return right && error.code() == malus::ErrorCode::input ? 0 : 1;
  }
}
