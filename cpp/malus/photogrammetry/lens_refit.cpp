#include <Eigen/QR>
#include <cmath>

#include "malus/photogrammetry/lens_refit_internal.h"

namespace malus {

LensRefit as_colmap_camera(const LensCamera& camera) {
  if (camera.model != LensModel::brown) return {camera, 0};
  constexpr int steps = 24;
  constexpr Eigen::Index count = 2 * (steps + 1) * (steps + 1);
  Eigen::MatrixXd equations(count, 8);
  Eigen::VectorXd pixels(count);
  Eigen::Index row = 0;
  for (int j = 0; j <= steps; ++j) {
    for (int i = 0; i <= steps; ++i) {
      const Eigen::Vector2d pixel((camera.size.width - 1.0) * i / steps, (camera.size.height - 1.0) * j / steps);
      const Eigen::Vector2d ideal = camera.undistort(pixel);
      const double x = ideal.x(), y = ideal.y(), r2 = ideal.squaredNorm();
      equations.row(row) << x, 1, 0, x * r2, x * r2 * r2, 2 * x * y, r2 + 2 * x * x, x * r2 * r2 * r2;
      equations.row(row + 1) << y, 0, 1, y * r2, y * r2 * r2, r2 + 2 * y * y, 2 * x * y, y * r2 * r2 * r2;
      pixels.segment<2>(row) = pixel;
      row += 2;
    }
  }
  const Eigen::VectorXd scale = equations.colwise().norm();
  const Eigen::MatrixXd scaled = equations * scale.cwiseInverse().asDiagonal();
  const Eigen::VectorXd fit = scale.cwiseInverse().asDiagonal() * scaled.colPivHouseholderQr().solve(pixels);
  const double f = fit[0];
  LensRefit result;
  result.camera.model = LensModel::full_opencv;
  result.camera.size = camera.size;
  result.camera.params = {f, f, fit[1], fit[2], fit[3] / f, fit[4] / f, fit[5] / f, fit[6] / f, fit[7] / f, 0, 0, 0};
  result.rms_px = std::sqrt((equations * fit - pixels).squaredNorm() * 2 / static_cast<double>(count));
  return result;
}

}  // namespace malus
