#include <ceres/ceres.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <mutex>
#include <numeric>
#include <string>

#include "malus/core/parallel_internal.h"
#include "malus/fusion/ceres_outcome_internal.h"
#include "malus/fusion/quad_costs_internal.h"
#include "malus/fusion/tile_solver_internal.h"
#include "malus/linalg/sequential_blas_internal.h"

namespace malus {
namespace {

static_assert(tile_ring_px == 2 * quad_px);

/// Change of the slopes from the prior whose weight is halved.
constexpr double slope_change = 0.1;

/// The solver starts almost with Gauss-Newton steps, because the start is close. Where these raise the cost, as in
/// paintings with a map of the surroundings, Ceres divides the radius by 2, 4, 8, ...: damping is felt after six
/// rejected steps, when the radius is about a half. Steps of a smaller one lower the cost, but no longer move the
/// surface.
constexpr double first_radius = 1e6;
constexpr int most_rejected = 6;

/// Borders of an even division of [0, length) into parts of at most about `largest`, on multiples of the prior blocks.
std::vector<int> borders(int length, int largest) {
  const int parts = std::max(1, (length + largest - 1) / largest);
  std::vector<int> at{0};
  for (int i = 1; i < parts; ++i) {
    const int border =
        static_cast<int>(std::lround(static_cast<double>(length) * i / parts / prior_block_px)) * prior_block_px;
    if (border > at.back() && border < length) at.push_back(border);
  }
  at.push_back(length);
  return at;
}

/// One tile's Ceres problem on its own copy of x.
class TileProblem {
 public:
  TileProblem(const RefinementField& field, const Tile& tile, const TileOptions& options)
      : field_(field),
        tile_(tile),
        local_(tile.outer.grown(tile_ring_px, field.size())),
        quads_{local_.u0 / quad_px, local_.v0 / quad_px, local_.u0 / quad_px + (local_.width() + 1) / quad_px,
               local_.v0 / quad_px + (local_.height() + 1) / quad_px},
        prior_loss_(options.prior_robust_gsd),
        slope_loss_(std::max(options.slope_weight * slope_change, 1e-9)),
        albedo_loss_(std::max(std::sqrt(field.albedo_weight) * field.albedo_contrast, 1e-9)) {
    copy_in();
    ceres::Problem::Options ownership;
    ownership.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    ownership.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    ownership.disable_all_safety_checks = true;
    ownership.evaluation_callback = &last_jacobian_;
    problem_ = std::make_unique<ceres::Problem>(ownership);
    add_parameters();
    add_costs(options);
  }

  SolveStatistics solve(const TileOptions& options, const Context& context) {
    SolveStatistics statistics;
    if (unknowns_ == 0) return statistics;
    statistics.tiles = 1;
    ceres::Solver::Options solver;
    solver.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
    solver.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
    solver.max_num_iterations = options.iterations + most_rejected;
    solver.max_num_consecutive_invalid_steps = 3;
    solver.initial_trust_region_radius = first_radius;
    solver.jacobi_scaling = false;
    solver.function_tolerance = solver.parameter_tolerance = solver.gradient_tolerance = 0;
    solver.num_threads = 1;
    const SequentialBlas sequential;  // tiles are the unit of parallelism
    solver.logging_type = ceres::SILENT;
    solver.linear_solver_ordering = nested_dissection();
    StopAfter stop(options.iterations, context);
    solver.callbacks.push_back(&stop);
    last_jacobian_.expect(options.iterations);
    ceres::Solver::Summary summary;
    ceres::Solve(solver, problem_.get(), &summary);
    statistics.cost_before = summary.initial_cost;
    statistics.cost_after = summary.initial_cost - stop.cost_change();
    statistics.accepted_steps = stop.accepted();
    statistics.rejected_steps = summary.num_unsuccessful_steps;
    statistics.failed_tiles =
        has_solution(summary, "refinement of a tile of " + std::to_string(unknowns_) + " unknowns (refine.tile_px)")
            ? 0
            : 1;
    statistics.solver_seconds = summary.total_time_in_seconds;
    statistics.linear_solver_seconds = summary.linear_solver_time_in_seconds;
    return statistics;
  }

  /// Solution on the outer rectangle, row major.
  std::vector<double> solution() const {
    std::vector<double> x;
    x.reserve(tile_.outer.size().area());
    for_each_pixel(tile_.outer, [&](int u, int v) { x.push_back(x_[pixel_index(u, v)]); });
    return x;
  }

 private:
  /// Ends after `steps` accepted steps, or when the run is canceled.
  class StopAfter final : public ceres::IterationCallback {
   public:
    StopAfter(int steps, const Context& context) : steps_(steps), context_(context) {}
    ceres::CallbackReturnType operator()(const ceres::IterationSummary& iteration) override {
      if (context_.canceled()) return ceres::SOLVER_ABORT;
      if (iteration.iteration > 0 && iteration.step_is_successful) {
        ++accepted_;
        cost_change_ += iteration.cost_change;
      }
      return accepted_ >= steps_ ? ceres::SOLVER_TERMINATE_SUCCESSFULLY : ceres::SOLVER_CONTINUE;
    }
    int accepted() const { return accepted_; }
    double cost_change() const { return cost_change_; }

   private:
    int steps_, accepted_ = 0;
    double cost_change_ = 0;
    const Context& context_;
  };

  /// Skips the Jacobian that Ceres evaluates after the last step, for a step that is never made.
  class SkipLastJacobian final : public ceres::EvaluationCallback {
   public:
    void expect(int steps) { left_ = steps; }
    const bool* finished() const { return &finished_; }
    void PrepareForEvaluation(bool evaluate_jacobians, bool /*new_evaluation_point*/) override {
      if (evaluate_jacobians) finished_ = left_-- <= 0;
    }

   private:
    int left_ = 0;
    bool finished_ = false;
  };

  /// Elimination order of the quads: the tile is cut in two recursively, with each cut ordered after its two parts. The
  /// factor has fewer entries than with minimum degree, which is used only inside the smallest parts. Cuts run along
  /// borders of prior blocks, because a block's cost joins all its quads.
  std::shared_ptr<ceres::ParameterBlockOrdering> nested_dissection() {
    auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
    int groups = 0;
    dissect(quads_, groups, *ordering);
    return ordering;
  }

  /// Appends a rectangle of quads to the order, with one group for each part and cut. Ceres would not sort the columns
  /// of separate parts in one group, and CHOLMOD needs the columns of a supernode together.
  void dissect(const PixelRect& quads, int& groups, ceres::ParameterBlockOrdering& ordering) {
    constexpr int block = prior_block_px / quad_px, smallest = 2 * block;
    PixelRect last = quads;
    if (std::max(quads.width(), quads.height()) > smallest) {
      const bool wide = quads.width() >= quads.height();
      const int cut = ((wide ? quads.u0 + quads.u1 : quads.v0 + quads.v1) / 2 + block / 2) / block * block;
      PixelRect before = quads, after = quads;
      (wide ? before.u1 : before.v1) = (wide ? last.u0 : last.v0) = cut;
      (wide ? last.u1 : last.v1) = (wide ? after.u0 : after.v0) = cut + 1;
      dissect(before, groups, ordering);
      dissect(after, groups, ordering);
    }
    for_each_quad(last, [&](QuadIndex quad) { ordering.AddElementToGroup(x_.data() + quad_offset(quad), groups); });
    ++groups;
  }

  bool is_local(QuadIndex q) const { return quads_.contains(q.column, q.row); }
  std::size_t quad_offset(QuadIndex q) const {
    return 4 * quads_.size().index(q.column - quads_.u0, q.row - quads_.v0);
  }
  std::size_t pixel_index(int u, int v) const {
    return quad_offset({u / quad_px, v / quad_px}) + static_cast<std::size_t>((v % quad_px) * quad_px + u % quad_px);
  }
  bool is_unknown(QuadIndex q) const { return tile_.outer.contains(quad_px * q.column, quad_px * q.row); }

  void copy_in() {
    x_.assign(4 * quads_.size().area(), 0.0);
    for_each_pixel(local_, field_.object, [&](int u, int v) { x_[pixel_index(u, v)] = field_.x(u, v); });
  }

  /// Calls visit(quad) for the quads of a rectangle that hold a part of the object.
  template <class Visit>
  void for_each_quad(const PixelRect& quads, Visit&& visit) const {
    for_each_pixel(quads, [&](int column, int row) {
      if (nodes_on_object(field_, {column, row}) > 0) visit(QuadIndex{column, row});
    });
  }

  void add_parameters() {
    for_each_quad(quads_, [&](QuadIndex quad) {
      double* block = x_.data() + quad_offset(quad);
      problem_->AddParameterBlock(block, 4);
      if (is_unknown(quad)) {
        ++unknowns_;
      } else {
        problem_->SetParameterBlockConstant(block);
      }
    });
  }

  /// Adds a cost if it depends on an unknown and all its quads are in this tile's copy.
  void add(std::unique_ptr<QuadCost> cost, ceres::LossFunction* loss = nullptr) {
    const auto& quads = cost->quads();
    if (!std::all_of(quads.begin(), quads.end(), [&](QuadIndex q) { return is_local(q); })) return;
    if (!std::any_of(quads.begin(), quads.end(), [&](QuadIndex q) { return is_unknown(q); })) return;
    std::vector<double*> blocks;
    blocks.reserve(quads.size());
    for (const QuadIndex quad : quads) blocks.push_back(x_.data() + quad_offset(quad));
    problem_->AddResidualBlock(cost.get(), loss, blocks);
    cost->watch(last_jacobian_.finished());
    costs_.push_back(std::move(cost));
  }

  ceres::LossFunction* keep(std::unique_ptr<ceres::LossFunction> loss) {
    losses_.push_back(std::move(loss));
    return losses_.back().get();
  }

  /// Share of noise in the variance of the polarization of a quad's diffuse pixels, at least `least`. The other part is
  /// the model's error, which smoothing does not average out. A mirror's polarization is far above its noise, and with
  /// a map of the surroundings other costs hold the slopes.
  double noise_share(QuadIndex quad) const {
    constexpr double least = 0.02;
    double sum = 0;
    int count = 0;
    for_each_node(field_, quad, [&](int u, int v, int) {
      ++count;
      if (field_.kind(u, v) != Reflection::diffuse || field_.reflection.mirrored) return;
      const double precision = field_.stokes_precision(u, v);
      sum += precision > 0 ? std::min(precision * field_.variance(u, v), 1.0) : 1;
    });
    return std::max(sum / std::max(count, 1), least);
  }

  void add_costs(const TileOptions& options) {
    for_each_quad(quads_, [&](QuadIndex quad) {
      if (nodes_on_object(field_, quad) < quad_px * quad_px) add(std::make_unique<OutsideCost>(field_, quad));
      for (const Axis axis : {Axis::u, Axis::v}) {
        if (nodes_on_object(field_, next_quad(quad, axis)) > 0)
          add(std::make_unique<SmoothnessCost>(field_, quad, axis, options.smoothness * noise_share(quad)));
      }
      for_each_node(field_, quad, [&](int u, int v, int) {
        if (options.slope_weight > 0)
          add(std::make_unique<SlopeChangeCost>(field_, u, v, options.slope_weight), &slope_loss_);
        if (field_.stokes_precision(u, v) > 0)
          add(std::make_unique<StokesCost>(field_, u, v), keep(std::make_unique<StokesLoss>(field_, u, v)));
        if (field_.albedo_weight > 0 && std::isfinite(field_.log_body(u, v)))
          add(std::make_unique<AlbedoCost>(field_, u, v), &albedo_loss_);
      });
    });
    const PixelRect blocks{local_.u0 / prior_block_px, local_.v0 / prior_block_px,
                           whole_blocks(local_.u1) / prior_block_px, whole_blocks(local_.v1) / prior_block_px};
    for_each_pixel(blocks, [&](int column, int row) {
      const double weight = field_.block_weight(column, row);
      if (weight <= 0) return;
      add(std::make_unique<PriorBlockCost>(field_, column, row),
          keep(std::make_unique<ceres::ScaledLoss>(&prior_loss_, weight, ceres::DO_NOT_TAKE_OWNERSHIP)));
    });
  }

  const RefinementField& field_;
  Tile tile_;
  PixelRect local_;
  PixelRect quads_;  ///< of the local pixels, in units of quads
  std::size_t unknowns_ = 0;
  std::vector<double> x_;  // quad by quad
  ceres::CauchyLoss prior_loss_, slope_loss_, albedo_loss_;
  SkipLastJacobian last_jacobian_;
  std::vector<std::unique_ptr<QuadCost>> costs_;
  std::vector<std::unique_ptr<ceres::LossFunction>> losses_;
  std::unique_ptr<ceres::Problem> problem_;
};

/// Weight of a tile at a coordinate: 1 inside, falling linearly across the core's border to 0 half a margin outside it.
double blend_weight(int at, int core0, int core1, int outer0, int outer1) {
  const auto ramp = [](double inside, double margin) {
    if (margin <= 0) return 1.0;  // border of the image
    return std::clamp(0.5 + inside / margin, 0.0, 1.0);
  };
  return ramp(at + 0.5 - core0, core0 - outer0) * ramp(core1 - at - 0.5, outer1 - core1);
}

/// Tiles by falling number of unknowns, so that no large tile is left for a single thread at the end.
std::vector<std::size_t> largest_first(const std::vector<Tile>& tiles, const Mask& object) {
  std::vector<int> unknowns(tiles.size(), 0);
  for (std::size_t i = 0; i < tiles.size(); ++i) {
    for_each_pixel(tiles[i].outer, object, [&](int, int) { ++unknowns[i]; });
  }
  std::vector<std::size_t> order(tiles.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return unknowns[a] > unknowns[b]; });
  return order;
}

}  // namespace

std::vector<Tile> divide_into_tiles(Size size, int core_px, int margin_px) {
  const int margin = whole_blocks(margin_px);
  int core_width = core_px, core_height = core_px;
  // A single tile would keep one thread busy and leave the others idle.
  constexpr int margins_worthwhile = 8;
  const int longer = std::max(size.width, size.height);
  if (longer <= core_px && longer >= margins_worthwhile * margin) {
    (size.width >= size.height ? core_width : core_height) = (longer + 1) / 2;
  }
  const std::vector<int> us = borders(size.width, core_width), vs = borders(size.height, core_height);
  std::vector<Tile> tiles;
  for (std::size_t j = 0; j + 1 < vs.size(); ++j) {
    for (std::size_t i = 0; i + 1 < us.size(); ++i) {
      const PixelRect core{us[i], vs[j], us[i + 1], vs[j + 1]};
      tiles.push_back({core, core.grown(margin, size)});
    }
  }
  return tiles;
}

std::vector<TileStrip> divide_into_strips(const std::vector<Tile>& tiles, Size image, double strip_px) {
  std::vector<RowRange> tile_rows;
  for (const Tile& tile : tiles) {
    if (tile.core.u0 == 0) tile_rows.push_back({tile.core.v0, tile.core.v1});
  }
  const std::size_t columns = tiles.size() / tile_rows.size();
  const double wanted = std::ceil(static_cast<double>(image.area()) / strip_px);
  const std::size_t count = static_cast<std::size_t>(std::min(wanted, static_cast<double>(tile_rows.size())));
  std::vector<TileStrip> strips;
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t first = i * tile_rows.size() / count, last = (i + 1) * tile_rows.size() / count;
    const auto at = [&](std::size_t row) { return tiles.begin() + static_cast<std::ptrdiff_t>(row * columns); };
    strips.push_back({{tile_rows[first].begin, tile_rows[last - 1].end}, {at(first), at(last)}});
  }
  return strips;
}

SolveStatistics& SolveStatistics::operator+=(const SolveStatistics& other) {
  cost_before += other.cost_before;
  cost_after += other.cost_after;
  accepted_steps += other.accepted_steps;
  rejected_steps += other.rejected_steps;
  failed_tiles += other.failed_tiles;
  tiles += other.tiles;
  solver_seconds += other.solver_seconds;
  linear_solver_seconds += other.linear_solver_seconds;
  return *this;
}

std::vector<TileSolution> solve_tiles(const RefinementField& field, const std::vector<Tile>& tiles,
                                      const TileOptions& options, const std::function<void()>& solved,
                                      const Context& context) {
  std::vector<TileSolution> solutions(tiles.size());
  std::mutex reporting;
  const std::vector<std::size_t> order = largest_first(tiles, field.object);
  parallel_for(context, tiles.size(), 1, [&](std::size_t k, std::size_t) {
    const std::size_t i = order[k];
    TileProblem problem(field, tiles[i], options);
    solutions[i].statistics = problem.solve(options, context);
    context.check_cancel();
    solutions[i].x = problem.solution();
    const std::lock_guard lock(reporting);
    solved();
  });
  return solutions;
}

BlendedTiles::BlendedTiles(Size image, const std::vector<Tile>& tiles)
    : sum_(image),
      column_weights_(static_cast<std::size_t>(image.width)),
      row_weights_(static_cast<std::size_t>(image.height)) {
  for (const auto& [core, outer] : tiles) {
    for (int u = outer.u0; core.v0 == 0 && u < outer.u1; ++u)
      column_weights_[static_cast<std::size_t>(u)] += blend_weight(u, core.u0, core.u1, outer.u0, outer.u1);
    for (int v = outer.v0; core.u0 == 0 && v < outer.v1; ++v)
      row_weights_[static_cast<std::size_t>(v)] += blend_weight(v, core.v0, core.v1, outer.v0, outer.v1);
  }
}

void BlendedTiles::add(const Tile& tile, const std::vector<double>& x) {
  const PixelRect &core = tile.core, &outer = tile.outer;
  const double* value = x.data();
  for (int v = outer.v0; v < outer.v1; ++v) {
    const double along_v = blend_weight(v, core.v0, core.v1, outer.v0, outer.v1);
    for (int u = outer.u0; u < outer.u1; ++u, ++value)
      sum_(u, v) += along_v * blend_weight(u, core.u0, core.u1, outer.u0, outer.u1) * *value;
  }
}

double BlendedTiles::replace(Image<double>& x, const Mask& object, const Context& context) const {
  std::vector<double> sums(static_cast<std::size_t>(x.height())), counts(sums);
  parallel_rows(context, x.height(), [&](int v) {
    const auto row = static_cast<std::size_t>(v);
    for (int u = 0; u < x.width(); ++u) {
      if (!object(u, v)) continue;
      const double blended = sum_(u, v) / (column_weights_[static_cast<std::size_t>(u)] * row_weights_[row]);
      const double change = blended - x(u, v);
      sums[row] += change * change;
      ++counts[row];
      x(u, v) = blended;
    }
  });
  return std::sqrt(std::accumulate(sums.begin(), sums.end(), 0.0) / std::accumulate(counts.begin(), counts.end(), 0.0));
}

}  // namespace malus
