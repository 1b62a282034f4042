#include "malus/surface/mesh.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>
#include <numeric>
#include <vector>

#include "malus/core/depth_normals.h"
#include "malus/core/parallel.h"
#include "malus/surface/display_image.h"

namespace malus {
namespace {

constexpr std::uint8_t cut_right = 1, cut_down = 2;

bool usable(float depth) {
  return std::isfinite(depth) && depth > 0;
}

/// Whether a depth discontinuity separates `here` from `there`, neighbours between `before` and `after` on one line.
bool is_step(float before, float here, float there, float after, double focal, const SurfaceOptions& options) {
  const double step = std::abs(static_cast<double>(there) - here);
  if (!(step * focal > options.min_step_gsd * std::min(here, there))) return false;
  double around = 0;
  if (usable(before)) around = std::abs(static_cast<double>(here) - before);
  if (usable(after)) around = std::max(around, std::abs(static_cast<double>(after) - there));
  return step > options.step_ratio * around;
}

/// For every pixel, whether the way to its right and lower neighbour is cut (discontinuity or missing depth).
Mask find_cuts(const FusedSurface& surface, const SurfaceOptions& options, const Context& context) {
  const Image<float>& depth = surface.depth;
  const int width = depth.width(), height = depth.height();
  Mask cuts(depth.size(), 1, cut_right | cut_down);
  const auto at = [&](int u, int v) { return depth.contains(u, v) ? depth(u, v) : -1.0f; };
  parallel_rows(context, height, [&](int v) {
    for (int u = 0; u < width; ++u) {
      const float here = depth(u, v);
      if (!usable(here)) continue;
      const float right = at(u + 1, v), down = at(u, v + 1);
      std::uint8_t cut = cut_right | cut_down;
      if (usable(right) && !is_step(at(u - 1, v), here, right, at(u + 2, v), surface.camera.fx, options))
        cut &= ~cut_right;
      if (usable(down) && !is_step(at(u, v - 1), here, down, at(u, v + 2), surface.camera.fy, options))
        cut &= ~cut_down;
      cuts(u, v) = cut;
    }
  });
  return cuts;
}

/// Corners of a grid cell, and the triangle at each corner (the corner and its two neighbours), counter-clockwise as
/// displayed: 0 top left, 1 top right, 2 bottom left, 3 bottom right.
using Corners = std::array<std::array<int, 2>, 4>;
constexpr std::array<std::array<int, 3>, 4> corner_triangles{{{0, 2, 1}, {1, 0, 3}, {2, 3, 0}, {3, 1, 2}}};

/// The grid of vertices (every subsample-th pixel), its cells, and which of their triangles exist.
class Grid {
 public:
  Grid(const FusedSurface& surface, const SurfaceOptions& options, const Context& context)
      : depth_(surface.depth),
        camera_(surface.camera),
        step_(options.subsample),
        min_cosine_(std::cos(options.max_incidence_deg * std::numbers::pi / 180)),
        size_{(depth_.width() - 1) / step_ + 1, (depth_.height() - 1) / step_ + 1} {
    if (size_.width < 2 || size_.height < 2) return;
    const Mask cuts = find_cuts(surface, options, context);
    cells_ = Mask({size_.width - 1, size_.height - 1});
    parallel_rows(context, cells_.height(), [&](int j) {
      for (int i = 0; i < cells_.width(); ++i) cells_(i, j) = triangles_of_cell(cuts, i, j);
    });
  }

  Size size() const { return size_; }
  int pixel(int index) const { return index * step_; }
  /// Bit c set: the triangle at corner c of this cell exists. 0 outside of the grid.
  std::uint8_t cell(int i, int j) const { return cells_.contains(i, j) ? cells_(i, j) : 0; }
  int cell_rows() const { return cells_.height(); }
  int cell_columns() const { return cells_.width(); }
  static Corners corners(int i, int j) { return {{{i, j}, {i + 1, j}, {i, j + 1}, {i + 1, j + 1}}}; }

  Eigen::Vector3d point(const std::array<int, 2>& vertex) const {
    const int u = pixel(vertex[0]), v = pixel(vertex[1]);
    return camera_.ray(u, v) * static_cast<double>(depth_(u, v));
  }

  /// Sum of the normals (twice the area long) of the triangles around a vertex; zero if there are none.
  Eigen::Vector3d normal_of_faces(int i, int j) const {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    visit_triangles_around(i, j, [&](const Corners& cell, const std::array<int, 3>& triangle) {
      const Eigen::Vector3d origin = point(cell[triangle[0]]);
      sum += (point(cell[triangle[1]]) - origin).cross(point(cell[triangle[2]]) - origin);
    });
    return sum;
  }

  bool is_used(int i, int j) const {
    bool used = false;
    visit_triangles_around(i, j, [&](const Corners&, const std::array<int, 3>&) { used = true; });
    return used;
  }

 private:
  template <class Visit>
  void visit_triangles_around(int i, int j, Visit&& visit) const {
    for (int corner = 0; corner < 4; ++corner) {  // the vertex is this corner of the cell
      const int cell_i = i - (corner & 1), cell_j = j - (corner >> 1);
      const std::uint8_t present = cell(cell_i, cell_j);
      for (int c = 0; c < 4; ++c) {
        const auto& triangle = corner_triangles[c];
        if ((present >> c & 1) && std::find(triangle.begin(), triangle.end(), corner) != triangle.end()) {
          visit(corners(cell_i, cell_j), triangle);
        }
      }
    }
  }

  bool is_cut(const Mask& cuts, int i, int j, std::uint8_t direction) const {
    const int du = direction == cut_right ? 1 : 0, dv = 1 - du;
    for (int k = 0; k < step_; ++k) {
      if (cuts(pixel(i) + k * du, pixel(j) + k * dv) & direction) return true;
    }
    return false;
  }

  std::uint8_t triangles_of_cell(const Mask& cuts, int i, int j) const {
    const bool top = !is_cut(cuts, i, j, cut_right), left = !is_cut(cuts, i, j, cut_down);
    const bool bottom = !is_cut(cuts, i, j + 1, cut_right), right = !is_cut(cuts, i + 1, j, cut_down);
    const std::array<bool, 4> possible{top && left, top && right, bottom && left, bottom && right};
    const Corners cell = corners(i, j);
    std::array<Eigen::Vector3d, 4> points;
    for (int c = 0; c < 4; ++c) points[c] = point(cell[c]);
    std::uint8_t present = 0;
    for (int c = 0; c < 4; ++c) {
      if (possible[c] && faces_camera(points, corner_triangles[c])) present |= static_cast<std::uint8_t>(1 << c);
    }
    constexpr std::uint8_t split_falling = 1 << 1 | 1 << 2, split_rising = 1 << 0 | 1 << 3;  // diagonal 0–3 and 1–2
    const auto count = [&](std::uint8_t split) { return std::popcount(static_cast<unsigned>(present & split)); };
    const int difference = count(split_falling) - count(split_rising);
    const bool falling = difference != 0
                             ? difference > 0
                             : (points[0] - points[3]).squaredNorm() < (points[1] - points[2]).squaredNorm();
    return present & (falling ? split_falling : split_rising);
  }

  bool faces_camera(const std::array<Eigen::Vector3d, 4>& points, const std::array<int, 3>& triangle) const {
    const Eigen::Vector3d& origin = points[triangle[0]];
    const Eigen::Vector3d normal = (points[triangle[1]] - origin).cross(points[triangle[2]] - origin);
    const double along = -normal.dot(origin);
    return along > 0 && along * along >= min_cosine_ * min_cosine_ * normal.squaredNorm() * origin.squaredNorm();
  }

  const Image<float>& depth_;
  Pinhole camera_;
  int step_;
  double min_cosine_;
  Size size_;
  Mask cells_;
};

/// Where each row starts, and the total behind the last one.
std::vector<std::size_t> starts_of(const std::vector<std::size_t>& counts) {
  std::vector<std::size_t> starts(counts.size() + 1, 0);
  std::inclusive_scan(counts.begin(), counts.end(), starts.begin() + 1);
  return starts;
}

void require_consistent(const FusedSurface& surface, const Image<float>& color) {
  require_size(surface.depth, surface.camera.size, "the depth map");
  if (!surface.normals.empty()) {
    require_size(surface.normals, surface.camera.size, "the normal map");
    if (surface.normals.channels() != 3)
      throw input_error("the normal map has " + std::to_string(surface.normals.channels()) + " channels, expected 3");
  }
  if (color.empty()) return;
  require_size(color, surface.camera.size, "the colour image");
  if (color.channels() != 1 && color.channels() != 3) {
    throw input_error("the colour image has " + std::to_string(color.channels()) + " channels, expected 1 or 3");
  }
}

/// Index of each grid vertex in the mesh, and the numbers of vertices.
struct VertexNumbers {
  Image<std::uint32_t> index;
  std::size_t count = 0;
};

constexpr std::uint32_t unused = 0xffffffff;

VertexNumbers number_vertices(const Grid& grid, const Context& context) {
  VertexNumbers numbers{Image<std::uint32_t>(grid.size(), 1, unused), 0};
  std::vector<std::size_t> counts(static_cast<std::size_t>(grid.size().height));
  parallel_rows(context, grid.size().height, [&](int j) {
    std::uint32_t count = 0;
    for (int i = 0; i < grid.size().width; ++i) {
      if (grid.is_used(i, j)) numbers.index(i, j) = count++;
    }
    counts[static_cast<std::size_t>(j)] = count;
  });
  const std::vector<std::size_t> starts = starts_of(counts);
  numbers.count = starts.back();
  if (numbers.count >= unused)
    throw resource_error("the mesh would have more than 4294967294 vertices; raise surface.subsample");
  parallel_rows(context, grid.size().height, [&](int j) {
    const auto start = static_cast<std::uint32_t>(starts[static_cast<std::size_t>(j)]);
    for (int i = 0; i < grid.size().width; ++i) {
      if (numbers.index(i, j) != unused) numbers.index(i, j) += start;
    }
  });
  return numbers;
}

/// Calls body(i, j, vertex number) for every vertex of the mesh.
template <class Body>
void for_vertices(const VertexNumbers& numbers, const Context& context, Body&& body) {
  parallel_rows(context, numbers.index.height(), [&](int j) {
    for (int i = 0; i < numbers.index.width(); ++i) {
      if (numbers.index(i, j) != unused) body(i, j, static_cast<std::size_t>(numbers.index(i, j)));
    }
  });
}

std::vector<std::array<std::uint32_t, 3>> collect_triangles(const Grid& grid, const VertexNumbers& numbers,
                                                            const Context& context) {
  std::vector<std::size_t> counts(static_cast<std::size_t>(grid.cell_rows()));
  parallel_rows(context, grid.cell_rows(), [&](int j) {
    for (int i = 0; i < grid.cell_columns(); ++i) {
      counts[static_cast<std::size_t>(j)] +=
          static_cast<std::size_t>(std::popcount(static_cast<unsigned>(grid.cell(i, j))));
    }
  });
  const std::vector<std::size_t> starts = starts_of(counts);
  std::vector<std::array<std::uint32_t, 3>> triangles(starts.back());
  parallel_rows(context, grid.cell_rows(), [&](int j) {
    std::size_t next = starts[static_cast<std::size_t>(j)];
    for (int i = 0; i < grid.cell_columns(); ++i) {
      const Corners cell = Grid::corners(i, j);
      for (int c = 0; c < 4; ++c) {
        if (!(grid.cell(i, j) >> c & 1)) continue;
        for (std::size_t k = 0; k < 3; ++k) {
          const auto& [column, row] = cell[corner_triangles[c][k]];
          triangles[next][k] = numbers.index(column, row);
        }
        ++next;
      }
    }
  });
  return triangles;
}

void fill_normals(const FusedSurface& surface, const Grid& grid, const VertexNumbers& numbers, const Context& context,
                  std::vector<Eigen::Vector3f>& normals) {
  const Image<float> differences =
      surface.normals.empty() ? normals_from_depth(surface.depth, surface.camera, context) : Image<float>();
  const Image<float>& map = surface.normals.empty() ? differences : surface.normals;
  const Eigen::Matrix3d world_from_cam = surface.pose.rotation.transpose();
  normals.resize(numbers.count);
  for_vertices(numbers, context, [&](int i, int j, std::size_t vertex) {
    const float* n = &map(grid.pixel(i), grid.pixel(j));
    Eigen::Vector3d normal(n[0], n[1], n[2]);
    if (!normal.allFinite()) normal = grid.normal_of_faces(i, j).normalized();  // a vertex always has a face
    normals[vertex] = (world_from_cam * normal).cast<float>();
  });
}

void fill_colors(const Image<std::uint8_t>& display, const Grid& grid, const VertexNumbers& numbers,
                 const Context& context, std::vector<Rgb>& colors) {
  colors.resize(numbers.count);
  for_vertices(numbers, context, [&](int i, int j, std::size_t vertex) {
    const std::uint8_t* pixel = &display(grid.pixel(i), grid.pixel(j));
    colors[vertex] = {pixel[0], pixel[1], pixel[2]};
  });
}

}  // namespace

TriangleMesh mesh_from_depth(const FusedSurface& surface, const Image<float>& color, const SurfaceOptions& options,
                             const Context& context) {
  validate_fields(options, "surface");
  require_consistent(surface, color);
  context.progress("mesh", 0, "triangulating");
  const Grid grid(surface, options, context);
  const VertexNumbers numbers = number_vertices(grid, context);
  if (numbers.count == 0) throw data_error("the fused depth has no connected pixels, so there is no surface to mesh");

  context.progress("mesh", 0.4, std::to_string(numbers.count) + " vertices");
  TriangleMesh mesh;
  mesh.triangles = collect_triangles(grid, numbers, context);
  mesh.vertices.points.resize(numbers.count);
  for_vertices(numbers, context, [&](int i, int j, std::size_t vertex) {
    mesh.vertices.points[vertex] = surface.pose.world_from_cam(grid.point({i, j}));
  });
  fill_normals(surface, grid, numbers, context, mesh.vertices.normals);
  if (!color.empty()) {
    fill_colors(display_image(color, surface.depth, options.white_percentile, context), grid, numbers, context,
                mesh.vertices.colors);
  }
  context.progress("mesh", 1, std::to_string(mesh.triangles.size()) + " triangles");
  return mesh;
}

int subsample_for(std::size_t triangles, int limit, const SurfaceOptions& options) {
  constexpr int largest = 64;
  const double factor = std::ceil(std::sqrt(static_cast<double>(triangles) / limit));
  return static_cast<int>(std::clamp(factor * options.subsample, 1.0 * options.subsample, 1.0 * largest));
}

}  // namespace malus
