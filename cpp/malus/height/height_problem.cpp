#include <cmath>

#include "malus/core/parallel_internal.h"
#include "malus/height/height_problem_internal.h"
#include "malus/polarization/fresnel.h"

namespace malus {
namespace {

/// Eq 11 divides by cos θ; at larger zeniths than this (87°) the quotient is noise.
constexpr double smallest_cosine = 0.05;
/// Share of the largest diagonal entry that is added to every diagonal entry: fixes the height's free constant. In
/// tiles with a `ring_height` the larger share holds all pixels to the start, which is better than what the data hardly
/// determine (decision 20).
constexpr double relative_ridge = 1e-11, relative_hold = 3e-4;
/// Weight of heights that are held: those in `ring_height`, and the prior's while it is continued.
constexpr double held_weight = 1e4;
constexpr std::size_t grain = 4096;

}  // namespace

HeightProblem::HeightProblem(const HeightData& data, const HeightOptions& options, const HeightLight& light,
                             const Context& context)
    : data_(data),
      options_(options),
      light_(light),
      camera_(data.camera ? &*data.camera : nullptr),
      rays_(data.perspective ? camera_ : nullptr),
      context_(context),
      pixels_(data.object),
      system_(pixels_),
      solver_(pixels_, context),
      frames_(static_cast<std::size_t>(pixels_.count())),
      terms_(frames_.size()) {
  for_each_pixel([&](int i) { frames_[static_cast<std::size_t>(i)] = frame_at(pixels_.u(i), pixels_.v(i)); });
}

bool HeightProblem::start_from_prior(Eigen::VectorXd& height) {
  height.resize(pixels_.count());
  for (int i = 0; i < pixels_.count(); ++i) height[i] = pixel(i).prior_height;
  if (height.allFinite()) return true;
  if (!height.array().isFinite().any()) return false;
  for_each_pixel([&](int i) { terms_[static_cast<std::size_t>(i)] = linear_term(i, false); });
  return solve_assembled(height, true) == SolveStatus::solved;
}

SolveStatus HeightProblem::solve_linear(bool literal, Eigen::VectorXd& height) {
  for_each_pixel([&](int i) { terms_[static_cast<std::size_t>(i)] = linear_term(i, literal); });
  return solve_assembled(height);
}

double HeightProblem::linearize(const Eigen::VectorXd& height) {
  return mean_of([&](int i) { return likelihood_term(i, height, terms_[static_cast<std::size_t>(i)]); });
}

SolveStatus HeightProblem::solve_linearized(Eigen::VectorXd& height) {
  return solve_assembled(height);
}

SolveStatus HeightProblem::solve_assembled(Eigen::VectorXd& height, bool holds_prior) {
  assemble(holds_prior);
  const bool goes_on = !data_.ring_height.empty();
  const double ridge = (goes_on ? relative_hold : relative_ridge) * system_.largest_diagonal();
  for (int i = 0; goes_on && i < pixels_.count(); ++i) system_.add_right(i, ridge * height[i]);
  return solver_.solve(system_, ridge, height);
}

double HeightProblem::slope_rms(const Eigen::VectorXd& height) const {
  return std::sqrt(mean_of([&](int i) { return gradient(i, height).squaredNorm(); }));
}

double HeightProblem::residual_rms(const Eigen::VectorXd& height) const {
  return std::sqrt(mean_of([&](int i) {
    return options_.method == HeightMethod::likelihood ? likelihood_square(i, height) : linear_square(i, height);
  }));
}

template <class Value>
double HeightProblem::mean_of(Value&& value) const {
  const auto part = [&](std::size_t begin, std::size_t end) {
    double sum = 0;
    for (std::size_t i = begin; i < end; ++i) sum += value(static_cast<int>(i));
    return sum;
  };
  return parallel_sum(context_, terms_.size(), grain, 0.0, part) / static_cast<double>(terms_.size());
}

template <class Body>
void HeightProblem::for_each_pixel(Body&& body) {
  parallel_for(context_, terms_.size(), grain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) body(static_cast<int>(i));
  });
}

/// Derivative along an axis at a pixel: central; at a border of the object one-sided over three pixels, exact for
/// parabolas, or over two if there is no third; count 0 if the pixel has no neighbor.
HeightProblem::Difference HeightProblem::difference(int u, int v, int du, int dv) const {
  const int here = pixels_.at(u, v), after = pixels_.at(u + du, v + dv), before = pixels_.at(u - du, v - dv);
  if (after >= 0 && before >= 0) return {{after, before, 0}, {0.5, -0.5, 0}, 2};
  if (after < 0 && before < 0) return {};
  const int near = after >= 0 ? after : before;
  const int step = after >= 0 ? 1 : -1;
  const int far = pixels_.at(u + 2 * step * du, v + 2 * step * dv);
  if (far >= 0) return {{here, near, far}, {-1.5 * step, 2.0 * step, -0.5 * step}, 3};
  return {{near, here, 0}, {1.0 * step, -1.0 * step, 0}, 2};
}

void HeightProblem::Term::add_row(const AffineSlopes& slopes, double p, double q, double target, double weight) {
  const double u = p * slopes.per_u.p + q * slopes.per_u.q, v = p * slopes.per_v.p + q * slopes.per_v.q;
  const double rest = target - p * slopes.constant.p - q * slopes.constant.q;
  uu += weight * u * u;
  uv += weight * u * v;
  vv += weight * v * v;
  right_u += weight * u * rest;
  right_v += weight * v * rest;
}

HeightProblem::Frame HeightProblem::frame_at(int u, int v) const {
  const RayFrame frame = ray_frame(rays_, u, v);
  const AffineSlopes slopes =
      rays_ != nullptr ? slopes_of_log_depth(*rays_, frame, u, v, -rays_->focal()) : slopes_of_height(camera_);
  const Eigen::Vector3d light = light_.coefficients.head<3>();
  const auto single = [](double value) { return static_cast<float>(value); };
  return {single(slopes.constant.p),      single(slopes.constant.q),   single(slopes.per_u.p),
          single(slopes.per_u.q),         single(slopes.per_v.p),      single(slopes.per_v.q),
          single(light.dot(frame.right)), single(light.dot(frame.up)), single(light.dot(frame.view))};
}

Eigen::Vector2d HeightProblem::gradient(int i, const Eigen::VectorXd& height) const {
  const int u = pixels_.u(i), v = pixels_.v(i);
  return {difference(u, v, 1, 0)(height), difference(u, v, 0, 1)(height)};
}

Slopes HeightProblem::slopes_of(int i, const Eigen::VectorXd& height) const {
  const Eigen::Vector2d along = gradient(i, height);
  return frame(i).slopes()(along[0], along[1]);
}

HeightProblem::LinearRows HeightProblem::linear_rows(int i, bool literal) const {
  const HeightPixel& data = pixel(i);
  const double i_un = data.i_un, s1 = data.s1, s2 = data.s2, s0 = 2 * i_un;
  double zenith = data.zenith;
  if (!literal) {
    const double degree = debiased_degree(std::hypot(s1, s2) / s0, data.variance_s / (s0 * s0));
    zenith = zenith_of(data.kind, degree, data_.refractive_index, data.branch).zenith_rad;
  }
  const double azimuth = azimuth_of(data.kind, 0.5 * std::atan2(s2, s1));
  const Eigen::Vector3d light(frame(i).light_right, frame(i).light_up, frame(i).light_view);
  const double scale = literal ? 1 : 1 / light.norm();
  const double cosine = std::max(std::cos(zenith), smallest_cosine);
  return {std::sin(azimuth), -std::cos(azimuth), literal ? 1 : std::min(std::tan(zenith), 1.0),
          scale * light[0],  scale * light[1],   scale * ((i_un - light_.coefficients[3]) / cosine - light[2])};
}

HeightProblem::Term HeightProblem::linear_term(int i, bool literal) const {
  Term term;
  if (!pixel(i).has_data()) return term;
  const LinearRows rows = linear_rows(i, literal);
  const AffineSlopes slopes = frame(i).slopes();
  term.add_row(slopes, rows.phase_p, rows.phase_q, 0, rows.phase_weight * rows.phase_weight);
  term.add_row(slopes, rows.shading_p, rows.shading_q, rows.shading_target, 1);
  return term;
}

double HeightProblem::linear_square(int i, const Eigen::VectorXd& height) const {
  if (!pixel(i).has_data()) return 0;
  const LinearRows rows = linear_rows(i, options_.method == HeightMethod::literal);
  const Slopes s = slopes_of(i, height);
  const double phase = rows.phase_weight * (rows.phase_p * s.p + rows.phase_q * s.q);
  const double shading = rows.shading_p * s.p + rows.shading_q * s.q - rows.shading_target;
  return phase * phase + shading * shading;
}

/// s0 ρ(θ) / tan²θ, signed: negative for specular reflection, polarized across the azimuth.
double HeightProblem::stokes_gain(const HeightPixel& data, double tan2) const {
  const double sin2 = tan2 / (1 + tan2), eta = data_.refractive_index;
  const double degree =
      data.kind == Reflection::specular ? -specular_degree_over_sin2(sin2, eta) : diffuse_degree_over_sin2(sin2, eta);
  return 2.0 * data.i_un * degree / (1 + tan2);
}

HeightProblem::Residuals HeightProblem::residuals(int i, const Slopes& s) const {
  const HeightPixel& data = pixel(i);
  const double i_un = data.i_un, s0 = 2 * i_un;
  const double shading_error = options_.shading_error ? *options_.shading_error * i_un : light_.shading_sigma;
  const double model = options_.stokes_error * s0;
  const double sigma_i = std::sqrt(data.variance_i + shading_error * shading_error);
  const double sigma_s = std::sqrt(data.variance_s + model * model);
  const Eigen::Vector3d light(frame(i).light_right, frame(i).light_up, frame(i).light_view);
  const double tan2 = s.tan2(), root = std::sqrt(1 + tan2);
  const double shading = (light[0] * s.p + light[1] * s.q + light[2]) / root;
  const double gain = stokes_gain(data, tan2), step = 1e-5 * (1 + tan2);
  const double gain_slope = (stokes_gain(data, tan2 + step) - gain) / step;  // by tan²θ
  const Eigen::Vector2d direction = s.direction();
  Residuals r;
  r.value = {(shading + light_.coefficients[3] - i_un) / sigma_i, (gain * direction[0] - data.s1) / sigma_s,
             (gain * direction[1] - data.s2) / sigma_s};
  r.by_p = {(light[0] / root - shading * s.p / (1 + tan2)) / sigma_i,
            (gain * 2 * s.p + gain_slope * 2 * s.p * direction[0]) / sigma_s,
            (gain * 2 * s.q + gain_slope * 2 * s.p * direction[1]) / sigma_s};
  r.by_q = {(light[1] / root - shading * s.q / (1 + tan2)) / sigma_i,
            (-gain * 2 * s.q + gain_slope * 2 * s.q * direction[0]) / sigma_s,
            (gain * 2 * s.p + gain_slope * 2 * s.q * direction[1]) / sigma_s};
  return r;
}

double HeightProblem::likelihood_square(int i, const Eigen::VectorXd& height) const {
  if (!pixel(i).has_data()) return 0;
  const Residuals r = residuals(i, slopes_of(i, height));
  return r.shading_square() * robust_weight(r.shading_square()) + r.stokes_square() * robust_weight(r.stokes_square());
}

double HeightProblem::likelihood_term(int i, const Eigen::VectorXd& height, Term& term) const {
  const Eigen::Vector2d along = gradient(i, height);
  term = {options_.damping, 0, options_.damping, options_.damping * along[0], options_.damping * along[1]};
  if (!pixel(i).has_data()) return 0;
  const AffineSlopes slopes = frame(i).slopes();
  const Slopes s = slopes(along[0], along[1]);
  const Residuals r = residuals(i, s);
  // Shading and polarization fail for different reasons: each keeps its own weight.
  const double shading_weight = robust_weight(r.shading_square()), stokes_weight = robust_weight(r.stokes_square());
  for (int k = 0; k < 3; ++k) {
    const double target = r.by_p[k] * s.p + r.by_q[k] * s.q - r.value[k];
    term.add_row(slopes, r.by_p[k], r.by_q[k], target, k == 0 ? shading_weight : stokes_weight);
  }
  return -square_limit() * std::log(shading_weight * stokes_weight);
}

void HeightProblem::assemble(bool holds_prior) {
  system_.clear(context_);
  const double border_weight = options_.boundary_weight * options_.boundary_weight;
  system_.for_each_unknown(context_, [&](int i) {
    const int u = pixels_.u(i), v = pixels_.v(i);
    add_term(terms_[static_cast<std::size_t>(i)], difference(u, v, 1, 0), difference(u, v, 0, 1));
    add_smoothness(i, pixels_.at(u - 1, v), pixels_.at(u + 1, v));
    add_smoothness(i, pixels_.at(u, v - 1), pixels_.at(u, v + 1));
    add_held(i, pixel(i).border_height, border_weight);
    if (!data_.ring_height.empty()) add_held(i, data_.ring_height(u, v), held_weight);
    if (holds_prior) add_held(i, pixel(i).prior_height, held_weight);
  });
}

void HeightProblem::add_term(const Term& term, const Difference& by_u, const Difference& by_v) {
  for (int i = 0; i < by_u.count; ++i) {
    system_.add_right(by_u.unknowns[i], by_u.coefficients[i] * term.right_u);
    for (int j = 0; j <= i; ++j) {
      system_.add(by_u.unknowns[i], by_u.unknowns[j], term.uu * by_u.coefficients[i] * by_u.coefficients[j]);
    }
    for (int j = 0; j < by_v.count; ++j) {
      // A diagonal entry stands for both orders of the product.
      const double twice = by_u.unknowns[i] == by_v.unknowns[j] ? 2 : 1;
      system_.add(by_u.unknowns[i], by_v.unknowns[j], twice * term.uv * by_u.coefficients[i] * by_v.coefficients[j]);
    }
  }
  for (int i = 0; i < by_v.count; ++i) {
    system_.add_right(by_v.unknowns[i], by_v.coefficients[i] * term.right_v);
    for (int j = 0; j <= i; ++j) {
      system_.add(by_v.unknowns[i], by_v.unknowns[j], term.vv * by_v.coefficients[i] * by_v.coefficients[j]);
    }
  }
}

void HeightProblem::add_smoothness(int here, int before, int after) {
  if (before < 0 || after < 0) return;
  const int unknowns[] = {before, here, after};
  const double coefficients[] = {1, -2, 1};
  system_.add_row(unknowns, coefficients, 3, 0, options_.smoothness * options_.smoothness);
}

void HeightProblem::add_held(int i, float target, double weight) {
  if (!std::isfinite(target)) return;
  system_.add(i, i, weight);
  system_.add_right(i, weight * target);
}

}  // namespace malus
