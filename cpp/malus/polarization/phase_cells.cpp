#include <algorithm>
#include <cmath>
#include <optional>

#include "malus/core/cell_values_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/polarization/phase_cells_internal.h"

namespace malus {
namespace {

constexpr double wanted_cells = 25000, most_cells = 100000;
constexpr double smallest_cell_px = 2, usual_cell_px = 4;
constexpr double min_tan2 = 0.0076;  // 5°

int side_of_cells(const PolarizationState& state) {
  const auto count = static_cast<double>(std::ranges::count(state.valid, static_cast<std::uint8_t>(PixelState::valid)));
  const double side = std::clamp(std::sqrt(count / wanted_cells), smallest_cell_px, usual_cell_px);
  return static_cast<int>(std::max(side, std::sqrt(count / most_cells)));
}

/// Mean of the valid pixels of a cell; nothing if most pixels are not valid or the surface is too flat.
std::optional<PhaseCell> cell_at(const PolarizationState& state, const StokesVariances& variances,
                                 const Pinhole* camera, const Image<float>& normals, int column, int row, int side) {
  PhaseCell cell;
  Eigen::Vector3d normal_sum = Eigen::Vector3d::Zero(), view_sum = Eigen::Vector3d::Zero();
  double variance_sum = 0;
  int count = 0;
  for_each_pixel(cell_rect(column, row, side, state.size()), [&](int u, int v) {
    if (!state.is_valid(u, v)) return;
    const Eigen::Vector3d normal(normals(u, v, 0), normals(u, v, 1), normals(u, v, 2));
    const RayFrame frame = ray_frame(camera, u, v);
    if (!(normal.dot(frame.view) > 0.1)) return;
    const Slopes here = frame.slopes(normal);
    const Eigen::Vector3d light = state.stokes(u, v);
    cell.slopes.p += light[0] * here.p;
    cell.slopes.q += light[0] * here.q;
    cell.stokes += light;
    variance_sum += variances(u, v, light).linear;
    normal_sum += normal;
    view_sum += frame.view;
    ++count;
  });
  if (2 * count <= side * side || !(cell.stokes[0] > 0)) return std::nullopt;
  cell.slopes.p /= cell.stokes[0];
  cell.slopes.q /= cell.stokes[0];
  if (cell.slopes.tan2() < min_tan2) return std::nullopt;
  cell.variance = variance_sum / (cell.stokes[0] * cell.stokes[0]);
  cell.stokes /= count;
  cell.u = side * column + 0.5 * (side - 1);
  cell.v = side * row + 0.5 * (side - 1);
  cell.normal = normal_sum.normalized();
  cell.view = view_sum.normalized();
  return cell;
}

}  // namespace

std::vector<PhaseCell> phase_cells(const PolarizationState& state, const Pinhole* camera, const Image<float>& normals,
                                   const Context& context) {
  require_size(normals, state.size(), "normals");
  const int side = side_of_cells(state);
  const StokesVariances variances(state);
  const Size count = cells_over(state.size(), side);
  std::vector<std::vector<PhaseCell>> rows(static_cast<std::size_t>(count.height));
  parallel_pixels(context, count, [&](int column, int row) {
    if (const auto cell = cell_at(state, variances, camera, normals, column, row, side))
      rows[static_cast<std::size_t>(row)].push_back(*cell);
  });
  std::vector<PhaseCell> cells;
  for (const std::vector<PhaseCell>& row : rows) cells.insert(cells.end(), row.begin(), row.end());
  return cells;
}

std::vector<int> parts_of(const std::vector<PhaseCell>& cells, int side) {
  std::vector<int> parts;
  if (cells.empty()) return parts;
  const auto [left, right] = std::ranges::minmax_element(cells, {}, &PhaseCell::u);
  const auto [top, bottom] = std::ranges::minmax_element(cells, {}, &PhaseCell::v);
  const double width = right->u - left->u + 1, height = bottom->v - top->v + 1;
  for (const PhaseCell& cell : cells) {
    const auto column = static_cast<int>(side * (cell.u - left->u) / width);
    const auto row = static_cast<int>(side * (cell.v - top->v) / height);
    parts.push_back(row * side + column);
  }
  return parts;
}

}  // namespace malus
