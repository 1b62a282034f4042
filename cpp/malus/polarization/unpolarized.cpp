#include <Eigen/QR>

#include "malus/core/parallel_internal.h"
#include "malus/polarization/polarizer_fit_internal.h"
#include "malus/polarization/unpolarized_internal.h"

namespace malus {

Image<float> unpolarized_intensity(const std::vector<Image<float>>& images, const std::vector<double>& angles_rad,
                                   const Context& context) {
  if (images.size() != angles_rad.size() || images.size() < 3) {
    throw input_error("unpolarized intensity: " + std::to_string(images.size()) + " images and " +
                      std::to_string(angles_rad.size()) + " angles, expected three or more of each");
  }
  for (const Image<float>& image : images) require_size(image, images.front().size(), "polarized image");
  const Eigen::CompleteOrthogonalDecomposition<Eigen::MatrixX3d> solver(2 * polarizer_rows(angles_rad));
  if (solver.rank() < 3) throw input_error("unpolarized intensity: the polarizer angles do not determine the sinusoid");
  const Eigen::VectorXd weights = solver.pseudoInverse().row(0);
  Image<float> intensity(images.front().size());
  parallel_pixels(context, intensity.size(), [&](int u, int v) {
    double sum = 0;
    for (std::size_t k = 0; k < images.size(); ++k) sum += weights[static_cast<Eigen::Index>(k)] * images[k](u, v);
    intensity(u, v) = static_cast<float>(sum);
  });
  return intensity;
}

}  // namespace malus
