#include <algorithm>
#include <cmath>
#include <functional>
#include <mutex>
#include <string>
#include <vector>

#include "malus/core/even_choice_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_sums_internal.h"
#include "malus/core/tiled_axis_internal.h"
#include "malus/height/height_internal.h"
#include "malus/height/height_problem_internal.h"

namespace malus {
namespace {

/// Gauss–Newton steps that raise the cost by more than this factor are halved, at most `most_halvings` times.
constexpr double allowed_rise = 1.05;
constexpr int most_halvings = 5;
/// Like whole_height_pixels, for the linear methods: they solve one system, the likelihood about ten.
constexpr std::size_t whole_linear_pixels = 500'000;
/// Tiles of larger rasters; neighboring tiles overlap by twice the margin.
constexpr int tile_px = 128, margin_px = 12;

void validate(const HeightInput& input, const HeightOptions& options) {
  validate_fields(options, "height");
  const Size size = input.polarization.size();
  require_size(input.reflection.label, size, "reflection labels");
  if (options.boundary == HeightBoundary::prior && input.prior_height == nullptr) {
    throw input_error("height.boundary = \"prior\" needs the height of the prior");
  }
  if (input.prior_height != nullptr) require_size(*input.prior_height, size, "prior height");
}

/// Subtracts the mean of the finite values.
void remove_mean(Image<float>& height, const Context& context) {
  constexpr std::size_t grain = 65536;
  const double mean = finite_mean(height, context);
  parallel_for(context, height.count(), grain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) height[i] = static_cast<float>(height[i] - mean);
  });
}

/// HeightMap::over_prior, over the pixels that have both heights.
double spread_over(const Image<float>& prior, const Image<float>& height, const Context& context) {
  constexpr std::size_t grain = 65536;
  using Sums = Eigen::Array<double, 5, 1>;  // of 1, the height, its square, the prior, its square
  const Sums zero = Sums::Zero();
  const Sums sums = parallel_sum(context, height.count(), grain, zero, [&](std::size_t begin, std::size_t end) {
    Sums part = Sums::Zero();
    for (std::size_t i = begin; i < end; ++i) {
      const double h = height[i], p = prior[i];
      if (std::isfinite(h + p)) part += Sums(1, h, h * h, p, p * p);
    }
    return part;
  });
  const double of_height = sums[0] * sums[2] - sums[1] * sums[1], of_prior = sums[0] * sums[4] - sums[3] * sums[3];
  return of_height > 0 && of_prior > 0 ? std::sqrt(of_height / of_prior) : 0;
}

/// One Gauss–Newton step. Before it the problem is linearized at `height`, where it has this `cost`; both are updated.
bool step(HeightProblem& problem, Eigen::VectorXd& height, double& cost, HeightMap& map) {
  Eigen::VectorXd next = height;
  if (problem.solve_linearized(next) != SolveStatus::solved) return false;
  ++map.iterations;
  double next_cost = problem.linearize(next);
  for (int halving = 0; halving < most_halvings && !(next_cost <= allowed_rise * cost); ++halving) {
    next = 0.5 * (next + height);
    next_cost = problem.linearize(next);
  }
  map.last_update = problem.slope_rms(next - height);
  height = next;
  cost = next_cost;
  return true;
}

/// Gauss–Newton from the start of lowest cost: the weighted linear solution (in `height`) is robust against noise, the
/// literal one is exact without noise, and the prior distinguishes hollows from bumps. Sets `height` to the result.
HeightStatus maximize_likelihood(HeightProblem& problem, const HeightOptions& options, const Context& context,
                                 Eigen::VectorXd& height, HeightMap& map) {
  Eigen::VectorXd next;
  if (problem.solve_linear(true, next) != SolveStatus::solved) return HeightStatus::singular;
  ++map.iterations;
  if (problem.linearize(next) < problem.linearize(height)) height = next;
  if (problem.start_from_prior(next) && problem.linearize(next) < problem.linearize(height)) height = next;
  double cost = problem.linearize(height);
  for (int iteration = 1; iteration <= options.iterations; ++iteration) {
    context.progress("height", static_cast<double>(iteration) / (options.iterations + 1));
    if (!step(problem, height, cost, map)) return HeightStatus::singular;
    if (map.last_update <= options.tolerance) return HeightStatus::converged;
  }
  return HeightStatus::iteration_limit;
}

/// Raster of the unknowns' heights, NaN elsewhere.
Image<float> raster_of(const Eigen::VectorXd& height, const PixelIndex& pixels) {
  Image<float> raster(pixels.size(), 1, no_value);
  for (int i = 0; i < pixels.count(); ++i) raster(pixels.u(i), pixels.v(i)) = static_cast<float>(height[i]);
  return raster;
}

/// Height of a raster by systems that cover all its pixels.
void solve_whole(const HeightData& data, const HeightOptions& options, const HeightLight& light, const Context& context,
                 HeightMap& map) {
  HeightProblem problem(data, options, light, context);
  Eigen::VectorXd height;
  const SolveStatus linear = problem.solve_linear(options.method == HeightMethod::literal, height);
  map.iterations = 1;
  map.solver_bytes = problem.solver_bytes();
  map.status = linear == SolveStatus::solved ? HeightStatus::converged : HeightStatus::singular;
  if (options.method == HeightMethod::likelihood && map.status == HeightStatus::converged)
    map.status = maximize_likelihood(problem, options, context, height, map);
  if (map.status == HeightStatus::singular) return;
  map.residual_rms = problem.residual_rms(height);
  map.height = raster_of(height, problem.pixels());
}

/// Holds to the start those pixels along a tile's edges beyond which the image continues.
void hold_ring(HeightData& tile, const Image<float>& start, PixelRect box) {
  constexpr int ring_px = GridSystem::reach;
  tile.ring_height = Image<float>(tile.size(), 1, no_value);
  for_each_pixel(box, [&](int u, int v) {
    if (box.is_at_cut(u, v, ring_px, start.size())) tile.ring_height(u - box.u0, v - box.v0) = start(u, v);
  });
}

/// One step in a tile.
HeightMap solve_tile(const HeightData& tile, const Image<float>& start, PixelRect box, const HeightOptions& options,
                     const HeightLight& light, const Context& context) {
  const bool likelihood = options.method == HeightMethod::likelihood;
  HeightProblem problem(tile, options, light, context);
  HeightMap map;
  map.height = Image<float>(tile.size(), 1, no_value);
  map.unknowns = static_cast<std::size_t>(problem.unknowns());
  if (problem.unknowns() == 0) return map;
  Eigen::VectorXd height(problem.unknowns());
  for (int i = 0; i < problem.unknowns(); ++i)
    height[i] = start(box.u0 + problem.pixels().u(i), box.v0 + problem.pixels().v(i));
  // If a tile cannot be solved, the start remains.
  if (likelihood) {
    // One step is enough: the start lacks only the finest detail.
    double cost = problem.linearize(height);
    step(problem, height, cost, map);
  } else if (Eigen::VectorXd solution = height;
             problem.solve_linear(options.method == HeightMethod::literal, solution) == SolveStatus::solved) {
    map.iterations = 1;
    height = solution;
  }
  map.unsolved_tiles = map.iterations == 0 ? 1 : 0;
  map.solver_bytes = problem.solver_bytes();
  map.residual_rms = problem.residual_rms(height);
  map.height = raster_of(height, problem.pixels());
  return map;
}

/// Share of the progress that precedes the tiles of the full resolution.
constexpr double share_before_tiles = 0.3;

/// The context for the work before the tiles.
Context before_tiles(const Context& context) {
  Context before = context;
  before.on_progress = [&context](const Progress& part) {
    context.progress(part.step, share_before_tiles * part.fraction, part.message);
  };
  return before;
}

/// One step in tiles from a start at the raster's resolution. tile(box) returns a tile's data. Sets map.height to the
/// result.
void solve_in_tiles(const std::function<HeightData(PixelRect)>& tile, const Image<float>& start,
                    const HeightOptions& options, const HeightLight& light, const Context& context, HeightMap& map) {
  const Size size = start.size();
  const TiledImage tiles(size, tile_px, margin_px);
  std::vector<HeightMap> results(static_cast<std::size_t>(tiles.tiles()));
  // One thread per tile, so that the tile's vectors stay in that core's cache.
  Context inner = context;
  inner.threads = 1;
  std::mutex reporting;
  std::size_t done = 0;
  parallel_for(context, results.size(), 1, [&](std::size_t k, std::size_t) {
    const PixelRect box = tiles.box(static_cast<int>(k));
    HeightData data = tile(box);
    hold_ring(data, start, box);
    results[k] = solve_tile(data, start, box, options, light, inner);
    const std::lock_guard lock(reporting);
    const double share = static_cast<double>(++done) / static_cast<double>(results.size());
    context.progress("height", share_before_tiles + (1 - share_before_tiles) * share, "in tiles");
  });

  map.height = Image<float>(size, 1, 0.0F);
  double squares = 0, changes = 0, pixels = 0;
  int steps = 0;
  for (int k = 0; k < tiles.tiles(); ++k) {
    const HeightMap& result = results[static_cast<std::size_t>(k)];
    const PixelRect box = tiles.box(k);
    parallel_pixels(context, box.size(), [&](int x, int y) {
      const auto weight = static_cast<float>(tiles.weight(k, box.u0 + x, box.v0 + y));
      if (weight > 0) map.height(box.u0 + x, box.v0 + y) += weight * result.height(x, y);
    });
    const auto unknowns = static_cast<double>(result.unknowns);
    squares += unknowns * result.residual_rms * result.residual_rms;
    changes += unknowns * result.last_update * result.last_update;
    pixels += unknowns;
    steps = std::max(steps, result.iterations);
    map.unsolved_tiles += result.unsolved_tiles;
    map.solver_bytes = std::max(map.solver_bytes, context.threads * result.solver_bytes);
  }
  map.iterations += steps;
  map.residual_rms = std::sqrt(squares / std::max(pixels, 1.0));
  map.last_update = std::sqrt(changes / std::max(pixels, 1.0));
}

/// Whether this many pixels are solved as a whole.
bool is_whole(std::size_t pixels, const HeightOptions& options) {
  return pixels <= (options.method == HeightMethod::likelihood ? whole_height_pixels : whole_linear_pixels);
}

/// Height of an object of any size: large ones are solved at half the resolution first, then in tiles. Only the
/// object's own pixels count: with those around it, a small object in a large image would be halved until little of it
/// is left.
void solve_by_levels(const HeightData& data, const HeightOptions& options, const HeightLight& light,
                     const Context& context, HeightMap& map) {
  if (is_whole(static_cast<std::size_t>(count_of_set(data.object)), options)) {
    solve_whole(data, options, light, context, map);
    return;
  }
  solve_by_levels(coarsened(data, context), options, light, before_tiles(context), map);
  if (map.status == HeightStatus::singular) return;
  const Image<float> start = refined_height(map.height, data.object, context);
  solve_in_tiles([&](PixelRect box) { return part_of(data, box); }, start, options, light, context, map);
}

}  // namespace

HeightMap solve_height(const HeightInput& input, const HeightOptions& options, const Context& context) {
  validate(input, options);
  const PolarizationState& state = input.polarization;
  HeightMap map;
  map.perspective = input.is_perspective(options);
  map.height = Image<float>(state.size(), 1, no_value);
  if (count_of_set(state.valid_pixels()) == 0) {
    map.status = HeightStatus::no_valid_pixels;
    return map;
  }
  const LightStatus found = input.light.status;
  if (found == LightStatus::too_few_pixels || found == LightStatus::normals_alike) {
    map.status = found == LightStatus::too_few_pixels ? HeightStatus::too_few_pixels_for_light
                                                      : HeightStatus::normals_too_alike_for_light;
    return map;
  }
  map.light = input.light.coefficients;
  if (found != LightStatus::estimated) {
    map.status = HeightStatus::light_along_view;
    return map;
  }
  const HeightLight model{map.light, input.light.robust_sigma};

  // Every pixel of the object gets a height; the smoothness term bridges pixels without usable polarization.
  const Mask object = state.object();
  map.unknowns = static_cast<std::size_t>(count_of_set(object));
  const PixelRect all{0, 0, state.size().width, state.size().height};
  // The data of a whole raster take much memory, whatever the object's size.
  if (!is_whole(state.size().area(), options)) {
    solve_by_levels(coarsened(input, options, context), options, model, before_tiles(context), map);
    if (map.status == HeightStatus::singular) {
      map.height = Image<float>(state.size(), 1, no_value);
      return map;
    }
    const Image<float> start = refined_height(map.height, object, context);
    const auto tile = [&](PixelRect box) {
      Context inner = context;
      inner.threads = 1;
      return height_data(input, options, box, inner);
    };
    solve_in_tiles(tile, start, options, model, context, map);
  } else {
    solve_whole(height_data(input, options, all, context), options, model, context, map);
    if (map.status == HeightStatus::singular) return map;
  }
  if (options.boundary == HeightBoundary::natural) remove_mean(map.height, context);
  if (input.prior_height != nullptr) map.over_prior = spread_over(*input.prior_height, map.height, context);
  context.progress("height", 1);
  return map;
}

Image<float> height_from_depth(const Image<float>& depth, const Pinhole& camera, bool perspective,
                               const Context& context) {
  const auto measure = [&](float z) { return perspective ? std::log(static_cast<double>(z)) : static_cast<double>(z); };
  // Values relative to one of the depths are small, so that single precision suffices until the mean is known.
  const auto known = std::find_if(depth.begin(), depth.end(), [](float z) { return std::isfinite(z); });
  if (known == depth.end()) return Image<float>(depth.size(), 1, no_value);
  auto height = Image<float>::uninitialized(depth.size());
  const double origin = measure(*known);
  constexpr std::size_t grain = 65536;
  parallel_for(context, depth.count(), grain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      height[i] = std::isfinite(depth[i]) ? static_cast<float>(origin - measure(depth[i])) : no_value;
    }
  });
  const double mean = finite_mean(height, context), scale = camera.focal() / (perspective ? 1 : origin - mean);
  parallel_for(context, depth.count(), grain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) height[i] = static_cast<float>(scale * (height[i] - mean));
  });
  return height;
}

}  // namespace malus
