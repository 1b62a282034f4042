#pragma once

#include <vector>

#include "malus/capture/affine_displacement_internal.h"
#include "malus/capture/compared_bands_internal.h"

namespace malus {

/// Normal equations of the steps of all images, and what their bands tell of each other.
struct RegistrationEquations {
  Matrix6 matrix = Matrix6::Zero();
  Matrix6 of_noise = Matrix6::Zero();  ///< the part of `matrix` that the images' disagreement explains
  std::vector<Vector6> sides;
  std::vector<std::vector<Vector6>> tile_sides;
  double gradient_energy = 0, noise_energy = 0;
  std::vector<double> products, others_energy;

  explicit RegistrationEquations(std::size_t images)
      : sides(images, Vector6::Zero()), products(images, 0.0), others_energy(images, 0.0) {}

  double texture() const { return gradient_energy > 0 ? 1 - noise_energy / gradient_energy : 0; }
};

/// The equations at the given maps. `assess`: with the energies, the products and the part of noise, which only the
/// assessment needs.
RegistrationEquations registration_equations(const ComparedBands& compared, const std::vector<Affine>& maps,
                                             bool assess, const RegistrationOptions& options, const Context& context);

}  // namespace malus
