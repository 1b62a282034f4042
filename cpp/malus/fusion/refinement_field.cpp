#include "malus/fusion/refinement_field.h"

#include <cmath>
#include <limits>

#include "malus/core/parallel.h"

namespace malus {
namespace {

constexpr float none = std::numeric_limits<float>::quiet_NaN();

double mean_log_depth(const Mask& object, const DepthPrior& prior) {
  double sum = 0, count = 0;
  for (std::size_t i = 0; i < object.count(); ++i) {
    if (!object[i]) continue;
    sum += std::log(static_cast<double>(prior.depth[i]));
    ++count;
  }
  if (count == 0) throw data_error("refine: the prior has a depth on no pixel of the object");
  return sum / count;
}

}  // namespace

RefinementField make_field(const PolarizationState& state, const DepthPrior& prior, const Context& context) {
  const Size size = state.size();
  require_size(prior.depth, size, "the prior's depth");
  if (!prior.sigma.empty()) require_size(prior.sigma, size, "the prior's sigma");
  RefinementField field;
  field.camera = prior.camera;
  field.focal = prior.camera.focal();
  field.object = Mask(size);
  for (std::size_t i = 0; i < field.object.count(); ++i) {
    const bool known = state.valid[i] != static_cast<std::uint8_t>(PixelState::outside);
    field.object[i] = known && prior.depth[i] > 0 && std::isfinite(prior.depth[i]) ? 255 : 0;
  }
  field.log_depth_origin = mean_log_depth(field.object, prior);
  field.usable = Mask(size);
  field.x = Image<double>(size, 1, std::numeric_limits<double>::quiet_NaN());
  field.s0 = field.s1 = field.s2 = field.variance = Image<float>(size, 1, none);
  field.kind = Image<std::uint8_t>(size);
  field.prior_sigma = Image<float>(size, 1, none);
  const StokesVariances variances(state);
  parallel_rows(context, size.height, [&](int v) {
    for (int u = 0; u < size.width; ++u) {
      if (!field.object(u, v)) continue;
      field.x(u, v) = field.focal * (std::log(static_cast<double>(prior.depth(u, v))) - field.log_depth_origin);
      const double gsd = static_cast<double>(prior.depth(u, v)) / field.focal;
      const double sigma = prior.sigma.empty() ? none : prior.sigma(u, v);
      field.prior_sigma(u, v) = static_cast<float>(std::isfinite(sigma) ? sigma / gsd : 1.0);
      const Eigen::Vector3d stokes = state.stokes(u, v);
      field.s0(u, v) = static_cast<float>(stokes[0]);
      field.s1(u, v) = static_cast<float>(stokes[1]);
      field.s2(u, v) = static_cast<float>(stokes[2]);
      field.variance(u, v) = static_cast<float>(variances(u, v, stokes).linear);
      field.usable(u, v) = state.is_valid(u, v) && stokes[0] > 0 && stokes.allFinite() ? 255 : 0;
    }
  });
  field.x_prior = field.x;
  prepare_weights(field);
  return field;
}

void prepare_weights(RefinementField& field) {
  const Size size = field.size();
  field.stokes_precision = Image<float>(size);
  field.mirror_body = Image<float>(size);
  field.regional_weight = Image<float>(size, 1, 1.0f);
  field.log_body = Image<float>(size, 1, none);
  field.block_weight = field.block_mean = Image<float>(field.block_count());
}

Eigen::Vector2d central_gradient(const RefinementField& field, int u, int v) {
  const double centre = field.x(u, v);
  const auto along = [&](int du, int dv) {
    double sum = 0;
    int count = 0;
    for (const int side : {-1, 1}) {
      if (!field.is_object(u + side * du, v + side * dv)) continue;
      sum += side * (field.x(u + side * du, v + side * dv) - centre);
      ++count;
    }
    return count == 0 ? 0.0 : sum / count;
  };
  return {along(1, 0), along(0, 1)};
}

Eigen::Vector2d central_slopes(const RefinementField& field, int u, int v) {
  const RaySlopes slopes = field.slopes_at(u, v);
  const Eigen::Vector2d gradient = central_gradient(field, u, v);
  return {slopes.p(gradient[0], gradient[1]), slopes.q(gradient[0], gradient[1])};
}

}  // namespace malus
