#include "malus/surface/mesh.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <memory>
#include <numeric>
#include <optional>
#include <sstream>
#include <vector>

#include "malus/core/degrees_internal.h"
#include "malus/core/depth_normals_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/surface/display_image_internal.h"

namespace malus {
namespace {

constexpr std::uint8_t cut_right = 1, cut_down = 2;

bool is_depth(float depth) {
  return std::isfinite(depth) && depth > 0;
}

/// Whether a depth discontinuity separates the neighbors `here` and `there`, which lie between `before` and `after` on
/// one line.
bool is_step(float before, float here, float there, float after, double focal, const SurfaceOptions& options) {
  const double step = std::abs(static_cast<double>(there) - here);
  if (!(step * focal > options.min_step_gsd * std::min(here, there))) return false;
  double around = 0;
  if (is_depth(before)) around = std::abs(static_cast<double>(here) - before);
  if (is_depth(after)) around = std::max(around, std::abs(static_cast<double>(after) - there));
  return step > options.step_ratio * around;
}

/// For the pixels of some rows, whether the connection to the right and to the lower neighbor is cut (discontinuity or
/// missing depth).
class Cuts {
 public:
  Cuts(const FusedSurface& surface, const SurfaceOptions& options, int first_row, int last_row)
      : first_row_(first_row), cuts_({surface.depth.width(), last_row - first_row}, 1, cut_right | cut_down) {
    const Image<float>& depth = surface.depth;
    const auto at = [&](int u, int v) { return depth.contains(u, v) ? depth(u, v) : -1.0f; };
    for_each_pixel(PixelRect{0, first_row, depth.width(), last_row}, [&](int u, int v) {
      const float here = depth(u, v);
      if (!is_depth(here)) return;
      const float right = at(u + 1, v), down = at(u, v + 1);
      std::uint8_t cut = cut_right | cut_down;
      if (is_depth(right) && !is_step(at(u - 1, v), here, right, at(u + 2, v), surface.camera.fx, options))
        cut &= ~cut_right;
      if (is_depth(down) && !is_step(at(u, v - 1), here, down, at(u, v + 2), surface.camera.fy, options))
        cut &= ~cut_down;
      cuts_(u, v - first_row) = cut;
    });
  }

  std::uint8_t operator()(int u, int v) const { return cuts_(u, v - first_row_); }

 private:
  int first_row_;
  Mask cuts_;
};

/// Corners of a grid cell, and the triangle at each corner (the corner and its two neighbors), counter-clockwise as
/// displayed: 0 top left, 1 top right, 2 bottom left, 3 bottom right.
constexpr std::array<std::array<std::size_t, 3>, 4> corner_triangles{{{0, 2, 1}, {1, 0, 3}, {2, 3, 0}, {3, 1, 2}}};
/// The triangles (bits) that contain each corner.
constexpr std::array<std::uint8_t, 4> triangles_at{0b0111, 0b1011, 0b1101, 0b1110};
/// How many bits of a cell are set; portable processors have no instruction for it.
constexpr std::array<std::uint8_t, 16> triangle_count{0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4};

/// Approximate number of pixels of a strip: its mesh stays in a core's cache while it is written.
constexpr int pixels_of_strip = 1 << 17;

/// The grid of vertices (every subsample-th pixel), its cells and their existing triangles; cut into strips of rows.
class Grid {
 public:
  Grid(const FusedSurface& surface, const SurfaceOptions& options, const Context& context)
      : depth_(surface.depth),
        sigma_(surface.sigma),
        camera_(surface.camera),
        step_(options.subsample),
        min_cosine_(std::cos(to_radians(options.max_incidence_deg))),
        max_sigma_(largest_sigma_gsd(options) / surface.camera.focal()),
        size_{(depth_.width() - 1) / step_ + 1, (depth_.height() - 1) / step_ + 1},
        strip_rows_(std::max(1, pixels_of_strip / (depth_.width() * step_))) {
    if (size_.width < 2 || size_.height < 2) return;
    cells_ = Mask::uninitialized({size_.width - 1, size_.height - 1});
    parallel_for(context, static_cast<std::size_t>(cells_.height()), static_cast<std::size_t>(strip_rows_),
                 [&](std::size_t begin, std::size_t end) {
                   const int first = static_cast<int>(begin), last = static_cast<int>(end);
                   const Cuts cuts(surface, options, pixel(first), pixel(last) + 1);
                   for_each_pixel(PixelRect{0, first, cells_.width(), last},
                                  [&](int i, int j) { cells_(i, j) = triangles_of_cell(cuts, i, j); });
                 });
  }

  Size size() const { return size_; }
  int pixel(int index) const { return index * step_; }
  std::size_t strips() const {
    return cells_.empty() ? 0 : static_cast<std::size_t>((size_.height + strip_rows_ - 1) / strip_rows_);
  }
  int first_row(std::size_t strip) const { return static_cast<int>(strip) * strip_rows_; }
  int last_row(std::size_t strip) const { return std::min(first_row(strip) + strip_rows_, size_.height); }
  /// Bit c set: the triangle at corner c of this cell exists. 0 outside of the grid.
  std::uint8_t cell(int i, int j) const { return cells_.contains(i, j) ? cells_(i, j) : 0; }

  Eigen::Vector3d point(int i, int j) const {
    const int u = pixel(i), v = pixel(j);
    return camera_.ray(u, v) * static_cast<double>(depth_(u, v));
  }

  /// Sum of the normals (of length twice the area) of the triangles around a vertex; zero if there are none.
  Eigen::Vector3d normal_of_faces(int i, int j) const {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (int corner = 0; corner < 4; ++corner) {  // the vertex is this corner of the cell
      const int cell_i = i - (corner & 1), cell_j = j - (corner >> 1);
      const unsigned around = cell(cell_i, cell_j) & triangles_at[static_cast<std::size_t>(corner)];
      if (around == 0) continue;
      const std::array points = corners(cell_i, cell_j);
      for (std::size_t c = 0; c < 4; ++c) {
        if (!(around >> c & 1)) continue;
        const Eigen::Vector3d& origin = points[corner_triangles[c][0]];
        sum += (points[corner_triangles[c][1]] - origin).cross(points[corner_triangles[c][2]] - origin);
      }
    }
    return sum;
  }

  bool is_used(int i, int j) const {
    return (cell(i, j) & triangles_at[0]) || (cell(i - 1, j) & triangles_at[1]) || (cell(i, j - 1) & triangles_at[2]) ||
           (cell(i - 1, j - 1) & triangles_at[3]);
  }

 private:
  std::array<Eigen::Vector3d, 4> corners(int i, int j) const {
    return {point(i, j), point(i + 1, j), point(i, j + 1), point(i + 1, j + 1)};
  }

  bool is_cut(const Cuts& cuts, int i, int j, std::uint8_t direction) const {
    const int du = direction == cut_right ? 1 : 0, dv = 1 - du;
    for (int k = 0; k < step_; ++k) {
      if (cuts(pixel(i) + k * du, pixel(j) + k * dv) & direction) return true;
    }
    return false;
  }

  /// Whether the standard deviation of this vertex is small enough; always true for a surface without standard
  /// deviations.
  bool is_known(int i, int j) const {
    const int u = pixel(i), v = pixel(j);
    return sigma_.empty() || !(sigma_(u, v) > max_sigma_ * depth_(u, v));
  }

  std::uint8_t triangles_of_cell(const Cuts& cuts, int i, int j) const {
    const bool top = !is_cut(cuts, i, j, cut_right), left = !is_cut(cuts, i, j, cut_down);
    const bool bottom = !is_cut(cuts, i, j + 1, cut_right), right = !is_cut(cuts, i + 1, j, cut_down);
    const bool a = is_known(i, j), b = is_known(i + 1, j), c = is_known(i, j + 1), d = is_known(i + 1, j + 1);
    const std::array<bool, 4> possible{top && left && a && b && c, top && right && a && b && d,
                                       bottom && left && a && c && d, bottom && right && b && c && d};
    const std::array points = corners(i, j);
    std::uint8_t present = 0;
    for (std::size_t k = 0; k < 4; ++k) {
      if (possible[k] && faces_camera(points, corner_triangles[k])) present |= static_cast<std::uint8_t>(1 << k);
    }
    constexpr std::uint8_t split_falling = 1 << 1 | 1 << 2, split_rising = 1 << 0 | 1 << 3;  // diagonal 0–3 and 1–2
    const auto count = [&](std::uint8_t split) { return static_cast<int>(triangle_count[present & split]); };
    const int difference = count(split_falling) - count(split_rising);
    const bool falling = difference != 0
                             ? difference > 0
                             : (points[0] - points[3]).squaredNorm() < (points[1] - points[2]).squaredNorm();
    return present & (falling ? split_falling : split_rising);
  }

  bool faces_camera(const std::array<Eigen::Vector3d, 4>& points, const std::array<std::size_t, 3>& triangle) const {
    const Eigen::Vector3d& origin = points[triangle[0]];
    const Eigen::Vector3d normal = (points[triangle[1]] - origin).cross(points[triangle[2]] - origin);
    const double along = -normal.dot(origin);
    return along > 0 && along * along >= min_cosine_ * min_cosine_ * normal.squaredNorm() * origin.squaredNorm();
  }

  const Image<float>& depth_;
  const Image<float>& sigma_;
  Pinhole camera_;
  int step_;
  double min_cosine_;
  double max_sigma_;  ///< divided by the depth
  Size size_;
  int strip_rows_;
  Mask cells_;
};

/// Start of each strip, followed by the total.
std::vector<std::size_t> starts_of(const std::vector<std::size_t>& counts) {
  std::vector<std::size_t> starts(counts.size() + 1, 0);
  std::inclusive_scan(counts.begin(), counts.end(), starts.begin() + 1);
  return starts;
}

void require_consistent(const FusedSurface& surface) {
  require_size(surface.depth, surface.camera.size, "the depth map");
  if (!surface.normals.empty()) {
    require_size(surface.normals, surface.camera.size, "the normal map");
    if (surface.normals.channels() != 3)
      throw input_error("the normal map has " + std::to_string(surface.normals.channels()) + " channels, expected 3");
  }
  if (!surface.sigma.empty()) require_size(surface.sigma, surface.camera.size, "the sigma map");
}

constexpr std::uint32_t unused = 0xffffffff;

/// Makes the strips of a mesh.
class StripMaker {
 public:
  StripMaker(const FusedSurface& surface, const Image<float>& color, const SurfaceOptions& options,
             const Context& context)
      : surface_(surface),
        grid_(surface, options, context),
        differences_(surface.normals.empty() ? normals_from_depth(surface.depth, surface.camera, context)
                                             : Image<float>()) {
    if (!color.empty()) display_.emplace(color, surface.depth, options.white_percentile);
    const std::size_t strips = grid_.strips();
    std::vector<std::size_t> vertices(strips), triangles(strips);
    std::vector<Eigen::AlignedBox3d> boxes(strips);
    parallel_for(context, strips, 1, [&](std::size_t k, std::size_t) {
      // Local variables, because threads that write to neighboring addresses wait for each other.
      std::size_t used = 0, faces = 0;
      Eigen::AlignedBox3d box;
      for_each_pixel(PixelRect{0, grid_.first_row(k), grid_.size().width, grid_.last_row(k)}, [&](int i, int j) {
        faces += triangle_count[grid_.cell(i, j)];
        if (!grid_.is_used(i, j)) return;
        ++used;
        box.extend(world_point(i, j));
      });
      vertices[k] = used;
      triangles[k] = faces;
      boxes[k] = box;
    });
    first_vertex_ = starts_of(vertices);
    first_triangle_ = starts_of(triangles);
    for (const Eigen::AlignedBox3d& box : boxes) box_.extend(box);
  }

  std::size_t strips() const { return grid_.strips(); }
  std::size_t vertices() const { return first_vertex_.back(); }
  std::size_t triangles() const { return first_triangle_.back(); }
  const Eigen::AlignedBox3d& box() const { return box_; }

  MeshStrip strip(std::size_t k, MeshInStrips::Parts parts) const {
    const int first = grid_.first_row(k), last = grid_.last_row(k), width = grid_.size().width;
    MeshStrip strip{first_vertex_[k], first_triangle_[k], first_vertex_[k + 1] - first_vertex_[k], {}};
    PointCloud& vertices = strip.mesh.vertices;
    const bool all = parts == MeshInStrips::Parts::all;
    vertices.points.reserve(strip.vertices + static_cast<std::size_t>(width));
    if (all) vertices.normals.reserve(strip.vertices);
    if (all && display_) vertices.colors.reserve(strip.vertices);
    strip.mesh.triangles.reserve(first_triangle_[k + 1] - first_triangle_[k]);

    std::vector<std::uint32_t> above(static_cast<std::size_t>(width)), below(above.size());
    for (int j = first; j < std::min(last + 1, grid_.size().height); ++j) {
      for (int i = 0; i < width; ++i) {
        std::uint32_t& number = below[static_cast<std::size_t>(i)];
        number = unused;
        if (!grid_.is_used(i, j)) continue;
        number = static_cast<std::uint32_t>(vertices.points.size());
        vertices.points.push_back(world_point(i, j));
        if (!all || j == last) continue;
        vertices.normals.push_back(world_normal(i, j));
        if (display_) vertices.colors.push_back((*display_)(grid_.pixel(i), grid_.pixel(j)));
      }
      if (j > first) add_triangles(j - 1, above, below, strip.mesh.triangles);
      above.swap(below);
    }
    return strip;
  }

 private:
  Eigen::Vector3d world_point(int i, int j) const { return surface_.pose.world_from_cam(grid_.point(i, j)); }

  Eigen::Vector3f world_normal(int i, int j) const {
    const Image<float>& map = surface_.normals.empty() ? differences_ : surface_.normals;
    const float* n = &map(grid_.pixel(i), grid_.pixel(j));
    Eigen::Vector3d normal(n[0], n[1], n[2]);
    if (!normal.allFinite()) normal = grid_.normal_of_faces(i, j).normalized();  // a vertex always has a face
    return (surface_.pose.rotation.transpose() * normal).cast<float>();
  }

  /// The triangles of a row of cells, from the numbers of the vertices above and below.
  void add_triangles(int j, const std::vector<std::uint32_t>& above, const std::vector<std::uint32_t>& below,
                     std::vector<std::array<std::uint32_t, 3>>& triangles) const {
    for (std::size_t i = 0; i + 1 < above.size(); ++i) {
      const unsigned present = grid_.cell(static_cast<int>(i), j);
      const std::array corners{above[i], above[i + 1], below[i], below[i + 1]};
      for (std::size_t c = 0; c < 4; ++c) {
        const auto& triangle = corner_triangles[c];
        if (present >> c & 1) triangles.push_back({corners[triangle[0]], corners[triangle[1]], corners[triangle[2]]});
      }
    }
  }

  const FusedSurface& surface_;
  Grid grid_;
  Image<float> differences_;  ///< normals, if the surface has none
  std::optional<DisplayColors> display_;
  std::vector<std::size_t> first_vertex_, first_triangle_;  ///< of each strip, followed by the total
  Eigen::AlignedBox3d box_;
};

}  // namespace

double largest_sigma_gsd(const SurfaceOptions& options, double prior_sigma_gsd) {
  constexpr double usual = 10, times_the_priors = 4, most = 1e9;  // the option's bound
  return options.max_sigma_gsd.value_or(std::min(std::max(usual, times_the_priors * prior_sigma_gsd), most));
}

MeshInStrips mesh_in_strips(const FusedSurface& surface, const Image<float>& color, const SurfaceOptions& options,
                            const Context& context) {
  validate_fields(options, "surface");
  require_consistent(surface);
  context.progress("mesh", 0, "triangulating");
  const auto maker = std::make_shared<const StripMaker>(surface, color, options, context);
  if (maker->vertices() == 0) {
    std::ostringstream message;
    if (options.subsample > 1) message << "with surface.subsample = " << options.subsample << ' ';
    message << "the fused depth has no connected pixels whose standard deviation is at most "
            << largest_sigma_gsd(options) << " GSD (surface.max_sigma_gsd), so there is no surface to mesh";
    throw data_error(message.str());
  }
  if (maker->vertices() >= unused)
    throw resource_error("the mesh would have more than 4294967294 vertices; raise surface.subsample");
  return {maker->vertices(), maker->triangles(),
          maker->strips(),   !color.empty(),
          maker->box(),      [maker](std::size_t k, MeshInStrips::Parts parts) { return maker->strip(k, parts); }};
}

TriangleMesh mesh_from_depth(const FusedSurface& surface, const Image<float>& color, const SurfaceOptions& options,
                             const Context& context) {
  const MeshInStrips strips = mesh_in_strips(surface, color, options, context);
  context.progress("mesh", 0.4, std::to_string(strips.vertices) + " vertices");
  TriangleMesh mesh;
  mesh.vertices.points.resize(strips.vertices);
  mesh.vertices.normals.resize(strips.vertices);
  if (strips.has_colors) mesh.vertices.colors.resize(strips.vertices);
  mesh.triangles.resize(strips.triangles);
  parallel_for(context, strips.strips, 1, [&](std::size_t k, std::size_t) {
    const auto place = [](const auto& values, std::size_t count, auto& whole, std::size_t first) {
      std::copy_n(values.begin(), count, whole.begin() + static_cast<std::ptrdiff_t>(first));
    };
    const MeshStrip strip = strips.strip(k, MeshInStrips::Parts::all);
    const PointCloud& vertices = strip.mesh.vertices;
    place(vertices.points, strip.vertices, mesh.vertices.points, strip.first_vertex);
    place(vertices.normals, strip.vertices, mesh.vertices.normals, strip.first_vertex);
    if (strips.has_colors) place(vertices.colors, strip.vertices, mesh.vertices.colors, strip.first_vertex);
    const auto start = static_cast<std::uint32_t>(strip.first_vertex);
    std::ranges::transform(strip.mesh.triangles,
                           mesh.triangles.begin() + static_cast<std::ptrdiff_t>(strip.first_triangle),
                           [start](const std::array<std::uint32_t, 3>& triangle) {
                             return std::array{triangle[0] + start, triangle[1] + start, triangle[2] + start};
                           });
  });
  context.progress("mesh", 1, std::to_string(mesh.triangles.size()) + " triangles");
  return mesh;
}

int subsample_for(std::size_t triangles, int limit, const SurfaceOptions& options) {
  constexpr int largest = 64;
  const double factor = std::ceil(std::sqrt(static_cast<double>(triangles) / limit));
  return static_cast<int>(std::clamp(factor * options.subsample, 1.0 * options.subsample, 1.0 * largest));
}

int subsample_for_glb(const FusedSurface& surface, std::size_t triangles, const SurfaceOptions& options,
                      const Context& context) {
  SurfaceOptions coarse = options;
  coarse.subsample = subsample_for(triangles, options.glb_triangles, options);
  while (coarse.subsample > options.subsample && StripMaker(surface, {}, coarse, context).triangles() == 0)
    coarse.subsample = std::max(options.subsample, coarse.subsample / 2);
  return coarse.subsample;
}

}  // namespace malus
