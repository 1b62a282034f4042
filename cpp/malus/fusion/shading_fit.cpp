#include <algorithm>

#include "malus/core/dense_systems_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/fusion/shading_fit_internal.h"
#include "malus/fusion/surroundings_internal.h"

namespace malus {
namespace {

/// Weighted least squares of y on the rows of A with Cauchy weights at 1.5 robust standard deviations.
Eigen::VectorXd robust_fit(const Eigen::MatrixXd& rows, const Eigen::VectorXd& values) {
  Eigen::VectorXd weights = Eigen::VectorXd::Ones(values.size()), solution;
  for (int round = 0; round < 20; ++round) {
    const Eigen::MatrixXd weighted = rows.array().colwise() * weights.array();
    solution = solve_symmetric(weighted.transpose() * rows, weighted.transpose() * values);
    const Eigen::VectorXd residual = values - rows * solution;
    const Eigen::VectorXd magnitude = residual.cwiseAbs();
    std::vector<double> magnitudes(magnitude.begin(), magnitude.end());
    const double spread = robust_spread(magnitudes);
    weights = 1 / (1 + (residual.array() / std::max(1.5 * spread, 1e-12)).square());
  }
  return solution;
}

/// Divides the harmonics by the median of their values at the samples, so that what is dark does not depend on the
/// exposure. Only ratios of shading are used.
void divide_by_median(ShadingHarmonics& harmonics, const Eigen::VectorXd& values) {
  const double usual = median(std::vector<double>(values.begin(), values.end()));
  if (usual > 0) harmonics /= usual;
}

}  // namespace

Shading fit_shading(const std::vector<ReflectionSample>& samples) {
  Shading shading;
  if (samples.size() < 100) return shading;
  const auto count = static_cast<Eigen::Index>(samples.size());
  Eigen::MatrixXd rows(count, 4);
  Eigen::VectorXd values(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const ReflectionSample& s = samples[static_cast<std::size_t>(i)];
    rows(i, 0) = 1;
    rows.row(i).tail<3>() = s.frame.normal(s.slopes).transpose();
    values[i] = s.s0;
  }
  shading.harmonics.head<4>() = robust_fit(rows, values);
  divide_by_median(shading.harmonics, rows * shading.harmonics.head<4>());
  const Eigen::Vector3d direct = robust_fit(rows.rightCols<3>(), values);
  if (direct.norm() > 0) shading.light = direct.normalized();
  return shading;
}

ShadingHarmonics fit_body_shading(const std::vector<ReflectionSample>& samples, const ReflectionModel& model) {
  ShadingHarmonics harmonics = ShadingHarmonics::Unit(0);
  if (samples.size() < 200) return harmonics;
  const auto count = static_cast<Eigen::Index>(samples.size());
  Eigen::MatrixXd rows(count, harmonics.size());
  Eigen::VectorXd values(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const ReflectionSample& s = samples[static_cast<std::size_t>(i)];
    rows.row(i) = shading_basis(s.frame.normal(s.slopes)).transpose();
    const MirroredLightTable& mirrored = *model.table_of(s.other_finish);
    values[i] = std::max(s.s0 - mirrored.at(s.slopes.p, s.slopes.q, s.frame).stokes[0], 0.0);
  }
  // Errors are relative to the body light, or to this limit where it is darker. A metal has no body light.
  const double darkest = darkest_shading * median(std::vector<double>(values.begin(), values.end()));
  if (darkest <= 0) return harmonics;
  Eigen::VectorXd errors = values.cwiseMax(darkest);
  for (int round = 0; round < 4; ++round) {
    const Eigen::MatrixXd relative = rows.array().colwise() / errors.array();
    harmonics = robust_fit(relative, values.cwiseQuotient(errors));
    errors = (rows * harmonics).cwiseMax(darkest);
  }
  divide_by_median(harmonics, rows * harmonics);
  return harmonics;
}

}  // namespace malus
