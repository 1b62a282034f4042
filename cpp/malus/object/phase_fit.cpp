#include <Eigen/SparseCore>
#include <algorithm>
#include <array>
#include <cmath>

#include "malus/core/parallel_internal.h"
#include "malus/core/square_internal.h"
#include "malus/linalg/conjugate_gradients_internal.h"
#include "malus/object/phase_fit_internal.h"
#include "malus/object/view_lookup_internal.h"

namespace malus {
namespace {

/// Standard deviation (GSD) of the second differences of a pixel's move across the surface: that of a slope which
/// changes by .4 over the length that shares errors, but at most 0.3. Small pixels see less bend (decision 121).
constexpr double bend_of_shared = 0.4, most_bend_gsd = 0.3;
/// Standard deviation of the sine between a normal and a phase's plane: a constant for interreflections, and a part
/// divided by the degree.
constexpr double turn = 0.08, turn_of_degree = 0.0012;
/// Beyond this many standard deviations the weight of a phase falls (Cauchy).
constexpr double robust = 2.0;
/// A station is asked for cells that lie within so many of its GSD of its own surface.
constexpr double most_off_gsd = 2.0;
/// Gauss–Newton steps; tolerance and most iterations of the linear solver.
constexpr int newton_steps = 3, most_linear_iterations = 300;
constexpr double linear_tolerance = 1e-3;
constexpr std::size_t unknowns_in_a_block = 1 << 12;

/// A cell as it was before any growth.
struct CellPlace {
  int unknown;
  Eigen::Vector3d middle, normal;  ///< world
};

std::vector<CellPlace> cell_places(const SurfaceCells& cells, std::size_t begin, std::size_t end) {
  const Eigen::VectorXd none = Eigen::VectorXd::Zero(cells.unknowns());
  const Eigen::Vector3d eye = cells.view().pose.center();
  std::vector<CellPlace> places;
  for (int i = static_cast<int>(begin); i < static_cast<int>(end); ++i) {
    if (!cells.begins_cell(i)) continue;
    const CellPoints corners = cells.corners(cells.corner_unknowns(i), none);
    const Eigen::Vector3d sum = corners[0] + corners[1] + corners[2] + corners[3];
    places.push_back({i, eye + sum / 4, CellSteps(corners).area().normalized()});
  }
  return places;
}

/// Whether a station is asked for the phase of a cell. One with larger pixels is not: its phase is a mean over detail
/// that the cells have, and would smooth it.
bool is_asked(const ObjectView& station, const ObjectView& view, const CellPlace& cell) {
  if (!(facing(station, cell.middle, cell.normal) > least_cosine)) return false;
  const auto at = meet(station, cell.middle);
  return at && std::abs(at->off(cell.middle)) < most_off_gsd * station.gsd &&
         !is_finer(view, facing(view, cell.middle, cell.normal), station, at->weight);
}

/// The step to the minimum of a system, and its solution.
Eigen::VectorXd solution(const GridSystem& system, const Context& context) {
  const Eigen::SparseMatrix<double, Eigen::RowMajor> matrix = system.lower(0).selfadjointView<Eigen::Lower>();
  const Eigen::VectorXd inverse = matrix.diagonal().cwiseInverse();
  Eigen::VectorXd x = Eigen::VectorXd::Zero(matrix.rows());
  const auto product = [&](const Eigen::VectorXd& direction, Eigen::VectorXd& out) {
    parallel_for(context, static_cast<std::size_t>(matrix.rows()), unknowns_in_a_block,
                 [&](std::size_t begin, std::size_t end) {
                   const auto first = static_cast<Eigen::Index>(begin), count = static_cast<Eigen::Index>(end - begin);
                   out.segment(first, count).noalias() = matrix.middleRows(first, count) * direction;
                 });
  };
  const auto precondition = [&](const Eigen::VectorXd& rest, Eigen::VectorXd& out) {
    out = inverse.cwiseProduct(rest);
  };
  conjugate_gradients(product, precondition, system.right(), linear_tolerance * system.right().norm(),
                      most_linear_iterations, context, x);
  return x;
}

}  // namespace

PhaseFit::PhaseFit(const SurfaceCells& cells, std::span<const PhasedView> stations, const Context& context)
    : cells_(cells),
      blocks_((static_cast<std::size_t>(cells.unknowns()) + unknowns_in_a_block - 1) / unknowns_in_a_block) {
  const auto ask = [&](std::size_t begin, std::size_t end) {
    const std::vector<CellPlace> places = cell_places(cells, begin, end);
    Eigen::AlignedBox3d box;
    for (const CellPlace& cell : places) box.extend(cell.middle);
    std::vector<const PhasedView*> near;
    for (const PhasedView& station : stations) {
      if (may_see(station.view, box)) near.push_back(&station);
    }
    Block& block = blocks_[begin / unknowns_in_a_block];
    block.begins.assign(end - begin + 1, 0);
    for (const CellPlace& cell : places) {
      const std::size_t before = block.phases.size();
      for (const PhasedView* station : near) {
        if (is_asked(station->view, cells.view(), cell)) block.phases.push_back(phase_planes(*station, cell.middle));
      }
      block.begins[static_cast<std::size_t>(cell.unknown) - begin + 1] = block.phases.size() - before;
    }
    for (std::size_t i = 1; i < block.begins.size(); ++i) block.begins[i] += block.begins[i - 1];
  };
  parallel_for(context, static_cast<std::size_t>(cells.unknowns()), unknowns_in_a_block, ask);
}

std::span<const PhasePlanes> PhaseFit::phases_of(int unknown) const {
  const auto i = static_cast<std::size_t>(unknown) % unknowns_in_a_block;
  const Block& block = blocks_[static_cast<std::size_t>(unknown) / unknowns_in_a_block];
  return std::span(block.phases).subspan(block.begins[i], block.begins[i + 1] - block.begins[i]);
}

Eigen::VectorXd PhaseFit::growth(const Context& context) const {
  Eigen::VectorXd growth = Eigen::VectorXd::Zero(cells_.unknowns());
  GridSystem system(cells_.pixels());
  for (int step = 0; step < newton_steps; ++step) {
    if (step > 0) system.clear(context);
    system.for_each_unknown(context, [&](int unknown) { add_equations(unknown, growth, system); });
    growth += solution(system, context);
  }
  return growth;
}

void PhaseFit::add_equations(int unknown, const Eigen::VectorXd& growth, GridSystem& system) const {
  const PixelIndex& pixels = cells_.pixels();
  const int u = pixels.u(unknown), v = pixels.v(unknown);
  add_place(unknown, growth, system);
  add_bend({unknown, pixels.at(u + 1, v), pixels.at(u + 2, v)}, growth, system);
  add_bend({unknown, pixels.at(u, v + 1), pixels.at(u, v + 2)}, growth, system);
  if (cells_.begins_cell(unknown)) add_phases(unknown, growth, system);
}

void PhaseFit::add_place(int unknown, const Eigen::VectorXd& growth, GridSystem& system) const {
  const double coefficient = cells_.across(unknown) / cells_.sigma(unknown);
  system.add_row(&unknown, &coefficient, 1, -coefficient * growth[unknown], 1);
}

void PhaseFit::add_bend(const std::array<int, 3>& line, const Eigen::VectorXd& growth, GridSystem& system) const {
  if (line[1] < 0 || line[2] < 0) return;
  constexpr std::array<double, 3> second_difference{1, -2, 1};
  const double bend_gsd = std::min(most_bend_gsd, bend_of_shared / cells_.view().shared_px);
  std::array<double, 3> coefficients;
  double bend = 0;
  for (std::size_t k = 0; k < line.size(); ++k) {
    coefficients[k] = second_difference[k] * cells_.across(line[k]) / bend_gsd;
    bend += coefficients[k] * growth[line[k]];
  }
  system.add_row(line.data(), coefficients.data(), 3, -bend, 1);
}

void PhaseFit::add_phases(int unknown, const Eigen::VectorXd& growth, GridSystem& system) const {
  const std::span<const PhasePlanes> phases = phases_of(unknown);
  if (phases.empty()) return;
  const std::array<int, 4> unknowns = cells_.corner_unknowns(unknown);
  const CellPoints corners = cells_.corners(unknowns, growth);
  const CellSteps steps(corners);
  const double size = steps.area().norm();
  const Eigen::Vector3d normal = steps.area() / size;
  for (const PhasePlanes& phase : phases) {
    const auto kind = clear_plane(phase, normal);
    if (!kind) continue;
    const Eigen::Vector3d& plane = phase.planes[*kind];
    const double sine = normal.dot(plane), sigma = std::hypot(turn, turn_of_degree / phase.degree);
    const double weight = 1 / square(sigma) / (1 + square(sine / (robust * sigma)));
    // The cell's normal is down × right; a corner's growth moves the corner along its ray.
    const Eigen::Vector3d of_right = plane.cross(steps.down) / size, of_down = steps.right.cross(plane) / size;
    std::array<double, 4> coefficients;
    for (std::size_t k = 0; k < corners.size(); ++k) {
      coefficients[k] = corners[k].dot(cell_corners[k].to_right * of_right + cell_corners[k].to_down * of_down);
    }
    system.add_row(unknowns.data(), coefficients.data(), 4, -sine, weight);
  }
}

}  // namespace malus
