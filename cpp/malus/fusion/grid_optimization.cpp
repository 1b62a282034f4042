#include <ceres/autodiff_cost_function.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "malus/core/depth_normals_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_sums_internal.h"
#include "malus/core/tiled_axis_internal.h"
#include "malus/fusion/ceres_outcome_internal.h"
#include "malus/fusion/grid_optimization_internal.h"
#include "malus/height/height_internal.h"
#include "malus/linalg/sequential_blas_internal.h"
#include "malus/linalg/stop_when_canceled_internal.h"
#include "malus/polarization/slopes_of_depth_internal.h"

namespace malus {
namespace {

constexpr int tile_px = 256, margin_px = 24;
/// Width of the strip of pixels along a tile's cut that are held.
constexpr int held_px = 2;
/// The widest cell whose mean is compared with the prior's. The mean joins each pixel of a cell with every other one,
/// so memory grows with the square of the width: here a tile's normal equations have some 75 million entries.
constexpr int widest_cell_px = 32;
/// Weight of the difference of both slopes to the prior's. Without it a pixel could leave the surface at no cost where
/// the equations contradict each other (a zenith of 90°, a wrong branch), because their residuals are bounded.
constexpr double slope_weight = 0.1;

/// Coefficients of the equations at one pixel.
struct PixelEquations {
  AffineSlopes slopes;
  double sine, cosine;                                ///< of the azimuth
  double light_right, light_up, light_view, shading;  ///< shares of the light's strength
  double cosine_zenith;
};

/// Eq 9, Eq 11, the zenith and the prior's slopes at one pixel, by its height and those of its neighbors on one side
/// along u and along v.
struct SideEquations {
  PixelEquations pixel;
  double side;   ///< 1: the next pixels, −1: the previous ones
  double share;  ///< factor on the residuals, 1 / √2 where the pixel has both sides
  Slopes prior;
  const OptimizeOptions& options;

  template <class T>
  bool operator()(const T* here, const T* beside_u, const T* beside_v, T* residuals) const {
    const T along_u = side * (*beside_u - *here), along_v = side * (*beside_v - *here);
    const AffineSlopes& s = pixel.slopes;
    const T p = s.constant.p + s.per_u.p * along_u + s.per_v.p * along_v;
    const T q = s.constant.q + s.per_u.q * along_u + s.per_v.q * along_v;
    const T facing = 1.0 / sqrt(1.0 + p * p + q * q);  // n · view
    const T lit = facing * (pixel.light_right * p + pixel.light_up * q + pixel.light_view);
    residuals[0] = share * options.phase_weight * facing * (pixel.sine * p - pixel.cosine * q);
    residuals[1] = share * options.shading_weight * (lit - pixel.shading);
    residuals[2] = share * options.zenith_weight * (facing - pixel.cosine_zenith);
    residuals[3] = share * slope_weight * (p - prior.p);
    residuals[4] = share * slope_weight * (q - prior.q);
    return true;
  }
};

/// Mean height of some pixels minus the prior's mean.
class CellMean final : public ceres::CostFunction {
 public:
  CellMean(std::size_t pixels, double prior_mean, double weight)
      : share_(weight / static_cast<double>(pixels)), target_(weight * prior_mean) {
    mutable_parameter_block_sizes()->assign(pixels, 1);
    set_num_residuals(1);
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const std::size_t pixels = parameter_block_sizes().size();
    residuals[0] = -target_;
    for (std::size_t i = 0; i < pixels; ++i) {
      residuals[0] += share_ * parameters[i][0];
      if (jacobians != nullptr && jacobians[i] != nullptr) jacobians[i][0] = share_;
    }
    return true;
  }

 private:
  double share_, target_;
};

/// How the solution of a tile ended. An unsolved tile keeps the surface that it started from.
enum class TileOutcome { converged, still_changing, unsolved };

/// One tile of the problem.
class GridTile {
 public:
  GridTile(const Image<float>& heights, const Image<float>& prior_heights, const Pinhole* camera,
           const OptimizeInput& input, const OptimizeOptions& options, const PixelRect& box)
      : heights_(heights),
        prior_heights_(prior_heights),
        camera_(camera),
        input_(input),
        options_(options),
        box_(box),
        values_(box.size().area()),
        reached_(values_.size(), false) {
    for_each_pixel(box, [&](int u, int v) { *at(u, v) = heights(u, v); });
  }

  TileOutcome solve(const Context& context) {
    for_each_pixel(box_, [&](int u, int v) { add_equations(u, v); });
    if (options_.prior_weight > 0) add_cells();
    if (problem_.NumResidualBlocks() == 0) return TileOutcome::converged;
    keep_unreached();
    hold_surroundings();
    ceres::Solver::Options how;
    how.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
    how.max_num_iterations = options_.iterations;
    how.function_tolerance = 1e-4;
    how.num_threads = 1;
    how.logging_type = ceres::SILENT;
    StopWhenCanceled stop(context);
    how.callbacks.push_back(&stop);
    ceres::Solver::Summary summary;
    const SequentialBlas sequential;  // tiles are the unit of parallelism
    ceres::Solve(how, &problem_, &summary);
    context.check_cancel();
    if (!has_solution(summary, "optimize.enabled")) return TileOutcome::unsolved;
    return summary.termination_type == ceres::CONVERGENCE ? TileOutcome::converged : TileOutcome::still_changing;
  }

  double value(int u, int v) const { return values_[index(u, v)]; }

 private:
  std::size_t index(int u, int v) const { return box_.size().index(u - box_.u0, v - box_.v0); }
  double* at(int u, int v) { return &values_[index(u, v)]; }
  bool has(int u, int v) const { return std::isfinite(heights_(u, v)); }

  void add_equations(int u, int v) {
    const Reflection kind = input_.reflection.at(u, v);
    if (kind == Reflection::outside || !has(u, v)) return;
    const RayFrame frame = ray_frame(camera_, u, v);
    const AffineSlopes slopes = camera_ != nullptr ? slopes_of_log_depth(*camera_, frame, u, v, -camera_->focal())
                                                   : slopes_of_height(&input_.prior.camera);
    const double azimuth = azimuth_of(kind, input_.polarization.phi(u, v));
    const double strength = input_.light.head<3>().norm();
    const Eigen::Vector3d light = input_.light.head<3>() / strength;
    const double shading = (input_.polarization.i_un(u, v) - input_.light[3]) / strength;
    const PixelEquations pixel{slopes,
                               std::sin(azimuth),
                               std::cos(azimuth),
                               light.dot(frame.right),
                               light.dot(frame.up),
                               light.dot(frame.view),
                               shading,
                               std::cos(input_.reflection.zenith(u, v))};
    // Slopes from one side alone belong to a point half a pixel away.
    const bool after = has_sides(u, v, 1), before = has_sides(u, v, -1);
    const double share = after && before ? std::numbers::sqrt2 / 2 : 1;
    if (after) add_side(pixel, u, v, 1, share);
    if (before) add_side(pixel, u, v, -1, share);
  }

  bool has_sides(int u, int v, int side) const {
    return box_.contains(u + side, v + side) && has(u + side, v) && has(u, v + side);
  }

  void add_side(const PixelEquations& pixel, int u, int v, int side, double share) {
    const double along_u = side * (prior_heights_(u + side, v) - prior_heights_(u, v));
    const double along_v = side * (prior_heights_(u, v + side) - prior_heights_(u, v));
    const Slopes prior = pixel.slopes(along_u, along_v);
    problem_.AddResidualBlock(new ceres::AutoDiffCostFunction<SideEquations, 5, 1, 1, 1>(
                                  new SideEquations{pixel, static_cast<double>(side), share, prior, options_}),
                              nullptr, at(u, v), at(u + side, v), at(u, v + side));
    reached_[index(u, v)] = reached_[index(u + side, v)] = reached_[index(u, v + side)] = true;
  }

  void add_cells() {
    const int cell = input_.cell_px;
    // Cells follow the grid of the whole image; a tile's first and last cells may be cut.
    for (int v0 = box_.v0 / cell * cell; v0 < box_.v1; v0 += cell) {
      for (int u0 = box_.u0 / cell * cell; u0 < box_.u1; u0 += cell) {
        std::vector<double*> pixels;
        double prior = 0;
        for_each_pixel(box_.intersected({u0, v0, u0 + cell, v0 + cell}), [&](int u, int v) {
          if (!has(u, v)) return;
          pixels.push_back(at(u, v));
          prior += prior_heights_(u, v);
        });
        if (pixels.empty()) continue;
        const auto count = static_cast<double>(pixels.size());
        problem_.AddResidualBlock(new CellMean(pixels.size(), prior / count, options_.prior_weight * std::sqrt(count)),
                                  nullptr, pixels);
      }
    }
  }

  /// Pixels that no equation reaches (in a corner of the image, or enclosed by pixels without polarization) keep their
  /// heights: the mean of a cell alone would let them drift.
  void keep_unreached() {
    for_each_pixel(box_, [&](int u, int v) {
      if (!has(u, v) || reached_[index(u, v)]) return;
      problem_.AddResidualBlock(new CellMean(1, heights_(u, v), 1), nullptr, std::vector<double*>{at(u, v)});
    });
  }

  void hold_surroundings() {
    for_each_pixel(box_, [&](int u, int v) {
      const bool is_held = box_.is_at_cut(u, v, held_px, heights_.size());
      if (is_held && problem_.HasParameterBlock(at(u, v))) problem_.SetParameterBlockConstant(at(u, v));
    });
  }

  const Image<float>&heights_, &prior_heights_;
  const Pinhole* camera_;  ///< null = orthographic
  const OptimizeInput& input_;
  const OptimizeOptions& options_;
  const PixelRect box_;
  std::vector<double> values_;
  std::vector<bool> reached_;  ///< by an equation
  ceres::Problem problem_;
};

void validate(const FusedSurface& surface, const OptimizeInput& input, const OptimizeOptions& options) {
  validate_fields(options, "optimize");
  const Size size = surface.depth.size();
  require_size(input.polarization.i_un, size, "polarization");
  require_size(input.reflection.zenith, size, "zenith");
  require_size(input.prior.depth, size, "prior depth");
  if (!(input.light.head<3>().norm() > 0))
    throw input_error("optimize.enabled = true needs the light that the polarization height was found with");
  if (input.cell_px > widest_cell_px && options.prior_weight > 0)
    throw input_error("grid.grid_px = " + std::to_string(input.cell_px) +
                      " with optimize.enabled = true, expected at most " + std::to_string(widest_cell_px) +
                      ": wider cells take too much memory");
}

/// Numbers of tiles by their outcome.
struct TileCounts {
  int all = 0, still_changing = 0, unsolved = 0;
};

/// Heights of all tiles, blended across their cuts.
Image<float> solve_tiles(const Image<float>& heights, const Image<float>& prior_heights, const Pinhole* camera,
                         const OptimizeInput& input, const OptimizeOptions& options, TileCounts& counts,
                         const Context& context) {
  const TiledImage tiled(heights.size(), tile_px, margin_px);
  const int tiles = tiled.tiles();
  Image<float> result(heights.size(), 1, 0.0F);
  std::vector<std::unique_ptr<GridTile>> group(static_cast<std::size_t>(std::max(context.threads, 1)));
  std::vector<TileOutcome> outcomes(group.size());
  counts.all = tiles;
  for (int first = 0; first < tiles; first += static_cast<int>(group.size())) {
    context.check_cancel();
    context.progress("fuse", 0.2 + 0.8 * first / tiles, "all equations together");
    parallel_for(context, group.size(), 1, [&](std::size_t i, std::size_t) {
      const int tile = first + static_cast<int>(i);
      group[i].reset();
      if (tile >= tiles) return;
      group[i] = std::make_unique<GridTile>(heights, prior_heights, camera, input, options, tiled.box(tile));
      outcomes[i] = group[i]->solve(context);
    });
    for (std::size_t i = 0; i < group.size(); ++i) {
      if (!group[i]) continue;
      const int tile = first + static_cast<int>(i);
      for_each_pixel(tiled.box(tile), [&](int u, int v) {
        const double weight = tiled.weight(tile, u, v);
        if (weight > 0) result(u, v) += static_cast<float>(weight * group[i]->value(u, v));
      });
      counts.still_changing += outcomes[i] == TileOutcome::still_changing ? 1 : 0;
      counts.unsolved += outcomes[i] == TileOutcome::unsolved ? 1 : 0;
    }
  }
  return result;
}

}  // namespace

void optimize_grid_surface(FusedSurface& surface, const OptimizeInput& input, const OptimizeOptions& options,
                           const Context& context) {
  validate(surface, input, options);
  const Pinhole& camera = surface.camera;
  const double focal = camera.focal();
  const Pinhole* rays = input.perspective ? &camera : nullptr;
  // Both heights refer to one origin, because each height has its own free constant.
  const double origin = finite_mean(input.prior.depth, context);
  const auto height_of = [&](float z) {
    return static_cast<float>(input.perspective ? -focal * std::log(z / origin) : focal * (1 - z / origin));
  };
  const auto heights_of = [&](const Image<float>& depth) {
    Image<float> heights(depth.size(), 1, no_value);
    for (std::size_t i = 0; i < depth.count(); ++i)
      if (std::isfinite(depth[i]) && std::isfinite(input.prior.depth[i])) heights[i] = height_of(depth[i]);
    return heights;
  };
  const Image<float> start = heights_of(surface.depth), prior = heights_of(input.prior.depth);
  TileCounts counts;
  const Image<float> heights = solve_tiles(start, prior, rays, input, options, counts, context);
  for (std::size_t i = 0; i < heights.count(); ++i) {
    if (!std::isfinite(start[i])) continue;
    const double h = heights[i];
    surface.depth[i] = static_cast<float>(input.perspective ? origin * std::exp(-h / focal) : origin * (1 - h / focal));
  }
  surface.normals = normals_from_depth(surface.depth, camera, context);
  surface.status = counts.unsolved > 0         ? FusionStatus::not_converged
                   : counts.still_changing > 0 ? FusionStatus::iteration_limit
                                               : FusionStatus::converged;
  // The caution of the grid transfer (Eq 16) no longer applies; the equations' assumptions are as untested as before.
  surface.confidence = {};
  surface.confidence.limit(
      ConfidenceLevel::partial,
      "All equations of the paper count alike: where light, albedo or reflection differ from what they "
      "assume, the difference becomes shape, and nothing shows where.");
  if (counts.unsolved > 0)
    surface.warnings.push_back("The equations could not be solved together in " + std::to_string(counts.unsolved) +
                               " of " + std::to_string(counts.all) +
                               " parts of the image: the surface there is that of the grid transfer.");
  if (counts.still_changing > 0)
    surface.warnings.push_back(
        "The surface was still changing when the solution of all equations together ended, after optimize.iterations "
        "= " +
        std::to_string(options.iterations) + " rounds: its fine detail is less sure. With more rounds it goes on.");
}

}  // namespace malus
