#include "malus/height/height.h"

#include <cmath>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "malus/core/parallel.h"
#include "malus/linalg/grid_solver.h"
#include "malus/linalg/grid_system.h"
#include "malus/polarization/fresnel.h"
#include "malus/polarization/ray_frame.h"

namespace malus {
namespace {

constexpr float none = std::numeric_limits<float>::quiet_NaN();
/// Eq 11 divides by cos θ; beyond this zenith (87°) the quotient is noise.
constexpr double smallest_cosine = 0.05;
/// Part of the largest diagonal entry added to every one: holds the height's free constant.
constexpr double relative_ridge = 1e-11;
/// |A x − b| / |b| at which an iterative solver ends: far below what a Gauss–Newton step leaves.
constexpr double solver_tolerance = 1e-6;
/// Gauss–Newton steps that raise the cost by more than this are halved, at most so often.
constexpr double allowed_rise = 1.05;
constexpr int most_halvings = 5;

/// A derivative at a pixel as a weighted sum of up to three unknowns.
struct Difference {
  int unknowns[3];
  double coefficients[3];
  int count = 0;

  double operator()(const Eigen::VectorXd& x) const {
    double sum = 0;
    for (int i = 0; i < count; ++i) sum += coefficients[i] * x[unknowns[i]];
    return sum;
  }
};

/// Derivative along an axis at a pixel: central; at a border of the object one-sided and exact for parabolas; across
/// two pixels if there are no more; count 0 if the pixel has no neighbour.
Difference difference(const PixelIndex& pixels, int u, int v, int du, int dv) {
  const int here = pixels.at(u, v), after = pixels.at(u + du, v + dv), before = pixels.at(u - du, v - dv);
  if (after >= 0 && before >= 0) return {{after, before, 0}, {0.5, -0.5, 0}, 2};
  if (after < 0 && before < 0) return {};
  const int near = after >= 0 ? after : before;
  const int step = after >= 0 ? 1 : -1;
  const int far = pixels.at(u + 2 * step * du, v + 2 * step * dv);
  if (far >= 0) return {{here, near, far}, {-1.5 * step, 2.0 * step, -0.5 * step}, 3};
  return {{near, here, 0}, {1.0 * step, -1.0 * step, 0}, 2};
}

/// Least-squares rows of one pixel, summed: ½ gᵀ A g − gᵀ b with the derivatives g = (h_u, h_v) of the height.
struct Term {
  double uu = 0, uv = 0, vv = 0, right_u = 0, right_v = 0;

  /// Adds weight · (p · P + q · Q − target)² for slopes affine in the derivatives.
  void add_row(const AffineSlopes& slopes, double p, double q, double target, double weight) {
    const double u = p * slopes.per_u.p + q * slopes.per_u.q, v = p * slopes.per_v.p + q * slopes.per_v.q;
    const double rest = target - p * slopes.constant.p - q * slopes.constant.q;
    uu += weight * u * u;
    uv += weight * u * v;
    vv += weight * v * v;
    right_u += weight * u * rest;
    right_v += weight * v * rest;
  }
};

/// What was measured at a pixel, with its standard deviations.
struct Observation {
  double i_un, s1, s2, sigma_i, sigma_s;
};

/// The height problem of one station: pixels, data, light.
class HeightProblem {
 public:
  HeightProblem(const HeightInput& input, const HeightOptions& options, const Pinhole* camera, const Mask& object,
                const Context& context)
      : input_(input),
        options_(options),
        camera_(camera),
        context_(context),
        pixels_(object),
        system_(pixels_),
        solver_(pixels_, {.method = options.solver, .tolerance = solver_tolerance}, context),
        terms_(static_cast<std::size_t>(pixels_.count())) {}

  int unknowns() const { return pixels_.count(); }
  double solver_bytes() const { return solver_.summary().bytes; }
  int solver_iterations() const { return solver_iterations_; }
  const PixelIndex& pixels() const { return pixels_; }

  void set_light(const Eigen::Vector4d& light, double sigma) {
    light_ = light;
    shading_sigma_ = sigma;
  }

  /// Solves the linear system of Eq 9 and 11.
  SolveStatus solve_linear(bool literal, Eigen::VectorXd& height) {
    for_each_pixel([&](int i) { terms_[static_cast<std::size_t>(i)] = linear_term(i, literal); });
    return solve(height);
  }

  /// Linearizes the likelihood at a height; returns its robust cost per pixel.
  double linearize(const Eigen::VectorXd& height) {
    const auto part = [&](std::size_t begin, std::size_t end) {
      double cost = 0;
      for (std::size_t i = begin; i < end; ++i) cost += likelihood_term(static_cast<int>(i), height, terms_[i]);
      return cost;
    };
    return parallel_sum(context_, terms_.size(), grain, 0.0, part) / static_cast<double>(terms_.size());
  }

  /// Minimizes the rows in hand plus smoothness and boundary; multigrid starts from `height` if that has a value.
  SolveStatus solve(Eigen::VectorXd& height) {
    assemble();
    const SolveStatus status = solver_.solve(system_, relative_ridge * system_.largest_diagonal(), height);
    solver_iterations_ += solver_.summary().iterations;
    return status;
  }

  /// RMS of the derivatives of a height.
  double slope_rms(const Eigen::VectorXd& height) const {
    const auto part = [&](std::size_t begin, std::size_t end) {
      double sum = 0;
      for (int i = static_cast<int>(begin); i < static_cast<int>(end); ++i) {
        const int u = pixels_.u(i), v = pixels_.v(i);
        const double along_u = difference(pixels_, u, v, 1, 0)(height),
                     along_v = difference(pixels_, u, v, 0, 1)(height);
        sum += along_u * along_u + along_v * along_v;
      }
      return sum;
    };
    return std::sqrt(parallel_sum(context_, terms_.size(), grain, 0.0, part) / static_cast<double>(terms_.size()));
  }

  /// RMS of the residuals of the linear rows in hand at a height, Eq 9 and 11 together.
  double residual_rms(const Eigen::VectorXd& height, bool literal, bool likelihood) {
    const auto part = [&](std::size_t begin, std::size_t end) {
      double sum = 0;
      for (std::size_t i = begin; i < end; ++i) {
        sum += likelihood ? likelihood_square(static_cast<int>(i), height)
                          : linear_square(static_cast<int>(i), height, literal);
      }
      return sum;
    };
    return std::sqrt(parallel_sum(context_, terms_.size(), grain, 0.0, part) / static_cast<double>(terms_.size()));
  }

 private:
  static constexpr std::size_t grain = 4096;

  template <class Body>
  void for_each_pixel(Body&& body) {
    parallel_for(context_, terms_.size(), grain, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) body(static_cast<int>(i));
    });
  }

  bool has_data(int u, int v) const { return input_.reflection.at(u, v) != Reflection::outside; }

  /// Slopes as an affine function of the derivatives of the height.
  AffineSlopes slopes_at(int u, int v) const {
    if (camera_ == nullptr) return {{0, 0}, {-1, 0}, {0, 1}};
    AffineSlopes slopes = slopes_of_log_depth(*camera_, u, v);
    const double scale = -1 / camera_->focal();
    for (Slopes* part : {&slopes.per_u, &slopes.per_v}) *part = {scale * part->p, scale * part->q};
    return slopes;
  }

  /// Light in the pixel's frame: right, up, view.
  Eigen::Vector3d light_at(int u, int v) const {
    const RayFrame frame = ray_frame(camera_, u, v);
    const Eigen::Vector3d light = light_.head<3>();
    return {light.dot(frame.right), light.dot(frame.up), light.dot(frame.view)};
  }

  Observation observation(int u, int v) const {
    const PolarizationState& state = input_.polarization;
    const Eigen::Vector3d stokes = state.stokes(u, v);
    const Eigen::Matrix3d covariance = state.stokes_covariance(u, v);
    const double shading = options_.shading_error ? *options_.shading_error * 0.5 * stokes[0] : shading_sigma_;
    const double model = options_.stokes_error * stokes[0];
    return {0.5 * stokes[0], stokes[1], stokes[2], std::sqrt(0.25 * covariance(0, 0) + shading * shading),
            std::sqrt(0.5 * (covariance(1, 1) + covariance(2, 2)) + model * model)};
  }

  struct LinearRows {
    double phase_p, phase_q, phase_weight;
    double shading_p, shading_q, shading_target;
  };

  LinearRows linear_rows(int u, int v, bool literal) const {
    const PolarizationState& state = input_.polarization;
    const ReflectionMap& reflection = input_.reflection;
    double zenith = reflection.zenith(u, v);
    if (!literal) {
      const double s0 = 2.0 * state.i_un(u, v);
      const Eigen::Matrix3d covariance = state.stokes_covariance(u, v);
      const double variance = 0.5 * (covariance(1, 1) + covariance(2, 2)) / (s0 * s0);
      zenith = zenith_of(reflection.at(u, v), debiased_degree(state.rho(u, v), variance), reflection.refractive_index,
                         reflection.branch(u, v))
                   .zenith_rad;
    }
    const double azimuth = state.phi(u, v) + (reflection.at(u, v) == Reflection::specular ? std::numbers::pi / 2 : 0);
    const Eigen::Vector3d light = light_at(u, v);
    const double scale = literal ? 1 : 1 / light.norm();
    const double cosine = std::max(std::cos(zenith), smallest_cosine);
    return {std::sin(azimuth), -std::cos(azimuth), literal ? 1 : std::min(std::tan(zenith), 1.0),
            scale * light[0],  scale * light[1],   scale * ((state.i_un(u, v) - light_[3]) / cosine - light[2])};
  }

  Term linear_term(int i, bool literal) const {
    Term term;
    const int u = pixels_.u(i), v = pixels_.v(i);
    if (!has_data(u, v)) return term;
    const LinearRows rows = linear_rows(u, v, literal);
    const AffineSlopes slopes = slopes_at(u, v);
    term.add_row(slopes, rows.phase_p, rows.phase_q, 0, rows.phase_weight * rows.phase_weight);
    term.add_row(slopes, rows.shading_p, rows.shading_q, rows.shading_target, 1);
    return term;
  }

  double linear_square(int i, const Eigen::VectorXd& height, bool literal) const {
    const int u = pixels_.u(i), v = pixels_.v(i);
    if (!has_data(u, v)) return 0;
    const LinearRows rows = linear_rows(u, v, literal);
    const Slopes s = slopes_of(i, height);
    const double phase = rows.phase_weight * (rows.phase_p * s.p + rows.phase_q * s.q);
    const double shading = rows.shading_p * s.p + rows.shading_q * s.q - rows.shading_target;
    return phase * phase + shading * shading;
  }

  Slopes slopes_of(int i, const Eigen::VectorXd& height) const {
    const int u = pixels_.u(i), v = pixels_.v(i);
    return slopes_at(u, v)(difference(pixels_, u, v, 1, 0)(height), difference(pixels_, u, v, 0, 1)(height));
  }

  /// s0 ρ(θ) / tan²θ, signed: negative where polarization is across the azimuth.
  double stokes_gain(int u, int v, double tan2) const {
    const double sin2 = tan2 / (1 + tan2), eta = input_.reflection.refractive_index;
    const double degree = input_.reflection.at(u, v) == Reflection::specular ? -specular_degree_over_sin2(sin2, eta)
                                                                             : diffuse_degree_over_sin2(sin2, eta);
    return 2.0 * input_.polarization.i_un(u, v) * degree / (1 + tan2);
  }

  /// Residuals of a pixel over their standard deviations and their derivatives by P and Q.
  struct Residuals {
    Eigen::Vector3d value, by_p, by_q;

    double shading_square() const { return value[0] * value[0]; }
    double stokes_square() const { return value[1] * value[1] + value[2] * value[2]; }
  };

  double square_limit() const { return options_.outlier_scale * options_.outlier_scale; }
  /// Cauchy weight of a squared residual.
  double robust_weight(double square) const { return 1 / (1 + square / square_limit()); }

  Residuals residuals(int u, int v, const Slopes& s) const {
    const Observation o = observation(u, v);
    const Eigen::Vector3d light = light_at(u, v);
    const double tan2 = s.tan2(), root = std::sqrt(1 + tan2);
    const double shading = (light[0] * s.p + light[1] * s.q + light[2]) / root;
    const double gain = stokes_gain(u, v, tan2), step = 1e-5 * (1 + tan2);
    const double gain_slope = (stokes_gain(u, v, tan2 + step) - gain) / step;  // by tan²θ
    const double difference_pq = s.p * s.p - s.q * s.q, product = 2 * s.p * s.q;
    Residuals r;
    r.value = {(shading + light_[3] - o.i_un) / o.sigma_i, (gain * difference_pq - o.s1) / o.sigma_s,
               (gain * product - o.s2) / o.sigma_s};
    r.by_p = {(light[0] / root - shading * s.p / (1 + tan2)) / o.sigma_i,
              (gain * 2 * s.p + gain_slope * 2 * s.p * difference_pq) / o.sigma_s,
              (gain * 2 * s.q + gain_slope * 2 * s.p * product) / o.sigma_s};
    r.by_q = {(light[1] / root - shading * s.q / (1 + tan2)) / o.sigma_i,
              (-gain * 2 * s.q + gain_slope * 2 * s.q * difference_pq) / o.sigma_s,
              (gain * 2 * s.p + gain_slope * 2 * s.q * product) / o.sigma_s};
    return r;
  }

  double likelihood_square(int i, const Eigen::VectorXd& height) const {
    const int u = pixels_.u(i), v = pixels_.v(i);
    if (!has_data(u, v)) return 0;
    const Residuals r = residuals(u, v, slopes_of(i, height));
    return r.shading_square() * robust_weight(r.shading_square()) +
           r.stokes_square() * robust_weight(r.stokes_square());
  }

  double likelihood_term(int i, const Eigen::VectorXd& height, Term& term) const {
    const int u = pixels_.u(i), v = pixels_.v(i);
    const double along_u = difference(pixels_, u, v, 1, 0)(height), along_v = difference(pixels_, u, v, 0, 1)(height);
    term = {options_.damping, 0, options_.damping, options_.damping * along_u, options_.damping * along_v};
    if (!has_data(u, v)) return 0;
    const Slopes s = slopes_at(u, v)(along_u, along_v);
    const Residuals r = residuals(u, v, s);
    // Shading and polarization fail for different reasons: each keeps its own weight.
    const double shading_weight = robust_weight(r.shading_square()), stokes_weight = robust_weight(r.stokes_square());
    const AffineSlopes slopes = slopes_at(u, v);
    for (int k = 0; k < 3; ++k) {
      const double target = r.by_p[k] * s.p + r.by_q[k] * s.q - r.value[k];
      term.add_row(slopes, r.by_p[k], r.by_q[k], target, k == 0 ? shading_weight : stokes_weight);
    }
    return -square_limit() * std::log(shading_weight * stokes_weight);
  }

  void assemble() {
    system_.clear();
    for (int i = 0; i < pixels_.count(); ++i) {
      if (i % 65536 == 0) context_.check_cancel();
      const int u = pixels_.u(i), v = pixels_.v(i);
      add_term(terms_[static_cast<std::size_t>(i)], difference(pixels_, u, v, 1, 0), difference(pixels_, u, v, 0, 1));
      add_smoothness(i, pixels_.at(u - 1, v), pixels_.at(u + 1, v));
      add_smoothness(i, pixels_.at(u, v - 1), pixels_.at(u, v + 1));
      if (options_.boundary == HeightBoundary::prior) add_boundary(i);
    }
  }

  void add_term(const Term& term, const Difference& by_u, const Difference& by_v) {
    for (int i = 0; i < by_u.count; ++i) {
      system_.add_right(by_u.unknowns[i], by_u.coefficients[i] * term.right_u);
      for (int j = 0; j <= i; ++j) {
        system_.add(by_u.unknowns[i], by_u.unknowns[j], term.uu * by_u.coefficients[i] * by_u.coefficients[j]);
      }
      for (int j = 0; j < by_v.count; ++j) {
        // An entry with itself stands for both orders of the product.
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

  void add_smoothness(int here, int before, int after) {
    if (before < 0 || after < 0) return;
    const int unknowns[] = {before, here, after};
    const double coefficients[] = {1, -2, 1};
    system_.add_row(unknowns, coefficients, 3, 0, options_.smoothness * options_.smoothness);
  }

  void add_boundary(int i) {
    const int u = pixels_.u(i), v = pixels_.v(i);
    const bool inside = pixels_.at(u - 1, v) >= 0 && pixels_.at(u + 1, v) >= 0 && pixels_.at(u, v - 1) >= 0 &&
                        pixels_.at(u, v + 1) >= 0;
    const float target = (*input_.prior_height)(u, v);
    if (inside || !std::isfinite(target)) return;
    const double weight = options_.boundary_weight * options_.boundary_weight;
    system_.add(i, i, weight);
    system_.add_right(i, weight * target);
  }

  const HeightInput& input_;
  const HeightOptions& options_;
  const Pinhole* camera_;
  const Context& context_;
  PixelIndex pixels_;
  GridSystem system_;
  GridSolver solver_;
  std::vector<Term> terms_;
  Eigen::Vector4d light_ = Eigen::Vector4d::Zero();
  double shading_sigma_ = 0;
  int solver_iterations_ = 0;
};

void validate(const HeightInput& input, const HeightOptions& options) {
  validate_fields(options, "height");
  const Size size = input.polarization.size();
  require_size(input.reflection.label, size, "reflection labels");
  if (!input.light && input.prior_normals == nullptr) {
    throw input_error("height: neither a light nor prior normals to estimate it with");
  }
  if (input.prior_normals != nullptr) require_size(*input.prior_normals, size, "prior normals");
  if (options.boundary == HeightBoundary::prior && input.prior_height == nullptr) {
    throw input_error("height.boundary = \"prior\" needs the height of the prior");
  }
  if (input.prior_height != nullptr) require_size(*input.prior_height, size, "prior height");
}

Mask pixels_in(const PolarizationState& state, PixelState least) {
  Mask mask(state.size());
  for (std::size_t i = 0; i < mask.count(); ++i) mask[i] = state.valid[i] >= static_cast<std::uint8_t>(least) ? 255 : 0;
  return mask;
}

/// The prior's height at every unknown, or nothing if it has none somewhere.
std::optional<Eigen::VectorXd> prior_start(const Image<float>& prior_height, const PixelIndex& pixels) {
  Eigen::VectorXd start(pixels.count());
  for (int i = 0; i < pixels.count(); ++i) start[i] = prior_height(pixels.u(i), pixels.v(i));
  return start.allFinite() ? std::optional(start) : std::nullopt;
}

/// Gauss–Newton from the likeliest start: the weighted linear solution (in `height`) withstands noise, the literal one
/// is exact without, the prior knows hollows from bumps. `height` becomes the result. Returns the status of the height
/// map.
std::string maximize_likelihood(HeightProblem& problem, const HeightInput& input, const HeightOptions& options,
                                const Context& context, Eigen::VectorXd& height, HeightMap& map) {
  Eigen::VectorXd next;
  if (problem.solve_linear(true, next) != SolveStatus::solved) return "singular";
  ++map.iterations;
  if (problem.linearize(next) < problem.linearize(height)) height = next;
  if (input.prior_height != nullptr) {
    const auto start = prior_start(*input.prior_height, problem.pixels());
    if (start && problem.linearize(*start) < problem.linearize(height)) height = *start;
  }
  double cost = problem.linearize(height);
  for (int iteration = 1; iteration <= options.iterations; ++iteration) {
    context.progress("height", static_cast<double>(iteration) / (options.iterations + 1));
    next = height;
    if (problem.solve(next) != SolveStatus::solved) return "singular";
    ++map.iterations;
    double next_cost = problem.linearize(next);
    for (int halving = 0; halving < most_halvings && !(next_cost <= allowed_rise * cost); ++halving) {
      next = 0.5 * (next + height);
      next_cost = problem.linearize(next);
    }
    map.last_update = problem.slope_rms(next - height);
    height = next;
    cost = next_cost;
    if (map.last_update <= options.tolerance) return "converged";
  }
  return "iteration limit";
}

}  // namespace

HeightMap solve_height(const HeightInput& input, const HeightOptions& options, const LightOptions& light_options,
                       const Context& context) {
  validate(input, options);
  const PolarizationState& state = input.polarization;
  const Pinhole* camera = options.perspective ? input.camera : nullptr;
  HeightMap map;
  map.perspective = camera != nullptr;
  map.height = Image<float>(state.size(), 1, none);

  const Mask valid = pixels_in(state, PixelState::valid);
  if (std::none_of(valid.begin(), valid.end(), [](std::uint8_t value) { return value != 0; })) {
    map.status = "no valid pixels";
    return map;
  }
  double shading_sigma = 0;
  double tangential = 0;
  if (input.light) {
    map.light = *input.light;
    tangential = tangential_light(map.light.head<3>(), camera, state.size());
  } else {
    const LightEstimate light = estimate_light(state.i_un, *input.prior_normals, valid, camera, light_options, context);
    if (light.status == LightStatus::too_few_pixels || light.status == LightStatus::normals_alike) {
      map.status = "light not found: " + std::string(enum_name(light.status));
      return map;
    }
    map.light = light.coefficients;
    shading_sigma = light.robust_sigma;
    tangential = light.tangential;
  }
  if (!(tangential >= light_options.min_tangential)) {
    map.status = enum_name(LightStatus::along_view);
    return map;
  }

  // Every pixel of the object gets a height; those without usable polarization are bridged by the smoothness.
  Mask object(state.size());
  for (std::size_t i = 0; i < object.count(); ++i) {
    object[i] = state.valid[i] != static_cast<std::uint8_t>(PixelState::outside) ? 255 : 0;
  }
  HeightProblem problem(input, options, camera, object, context);
  map.unknowns = static_cast<std::size_t>(problem.unknowns());
  problem.set_light(map.light, shading_sigma);

  Eigen::VectorXd height;
  const bool literal = options.method == HeightMethod::literal;
  const SolveStatus linear = problem.solve_linear(literal, height);
  map.iterations = 1;
  map.solver_bytes = problem.solver_bytes();
  map.solver_iterations = problem.solver_iterations();
  if (linear != SolveStatus::solved) {
    map.status = "singular";
    return map;
  }
  const bool likelihood = options.method == HeightMethod::likelihood;
  map.status = likelihood ? maximize_likelihood(problem, input, options, context, height, map) : "converged";
  map.solver_iterations = problem.solver_iterations();
  if (map.status == "singular") return map;
  map.residual_rms = problem.residual_rms(height, literal, likelihood);

  const double mean = options.boundary == HeightBoundary::prior ? 0.0 : height.mean();
  for (int i = 0; i < problem.unknowns(); ++i) {
    map.height(problem.pixels().u(i), problem.pixels().v(i)) = static_cast<float>(height[i] - mean);
  }
  context.progress("height", 1);
  return map;
}

Image<float> height_from_depth(const Image<float>& depth, const Pinhole& camera, bool perspective) {
  const auto measure = [&](float z) { return perspective ? std::log(static_cast<double>(z)) : static_cast<double>(z); };
  double sum = 0;
  std::size_t count = 0;
  for (const float z : depth) {
    if (!std::isfinite(z)) continue;
    sum += measure(z);
    ++count;
  }
  Image<float> height(depth.size(), 1, none);
  if (count == 0) return height;
  const double mean = sum / static_cast<double>(count);
  const double scale = perspective ? camera.focal() : camera.focal() / mean;
  for (std::size_t i = 0; i < depth.count(); ++i) {
    if (std::isfinite(depth[i])) height[i] = static_cast<float>(-scale * (measure(depth[i]) - mean));
  }
  return height;
}

}  // namespace malus
