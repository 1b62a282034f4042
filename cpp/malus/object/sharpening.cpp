#include <string>
#include <vector>

#include "malus/core/parallel_internal.h"
#include "malus/object/phase_fit_internal.h"
#include "malus/object/sharpening_internal.h"
#include "malus/object/view_lookup_internal.h"

namespace malus {
namespace {

/// Side of a tile, and the margin about it (pixels).
constexpr int usual_tile_px = 512, beside_px = 32;

/// Growth of all pixels of a view.
Image<double> growths(const ObjectView& view, std::span<const PhasedView> stations, int tile_px,
                      const Context& context) {
  const Size size = view.camera.size;
  std::vector<PixelRect> tiles;
  for (int row = 0; row * tile_px < size.height; ++row) {
    for (int column = 0; column * tile_px < size.width; ++column)
      tiles.push_back(cell_rect(column, row, tile_px, size));
  }
  Image<double> growth(size);
  parallel_for(context, tiles.size(), 1, [&](std::size_t k, std::size_t) {
    const PixelRect window = tiles[k].grown(beside_px, size);
    const SurfaceCells cells(view, window);
    if (cells.unknowns() == 0) return;
    const Eigen::VectorXd part = PhaseFit(cells, stations, context).growth(context);
    for (int i = 0; i < cells.unknowns(); ++i) {
      const int u = window.u0 + cells.pixels().u(i), v = window.v0 + cells.pixels().v(i);
      if (tiles[k].contains(u, v)) growth(u, v) = part[i];
    }
  });
  return growth;
}

/// Sum of the normals of the cells about a pixel after a growth, each as long as the cell is large; zero without cells.
Eigen::Vector3d areas_about(const ObjectView& view, const Image<double>& growth, int u, int v) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const CellCorner& place : cell_corners) {
    const int first_u = u - place.du, first_v = v - place.dv;
    if (first_u < 0 || first_v < 0 || !is_cell(view, first_u, first_v)) continue;
    CellPoints corners;
    for (std::size_t k = 0; k < corners.size(); ++k) {
      const int column = first_u + cell_corners[k].du, row = first_v + cell_corners[k].dv;
      corners[k] = (1 + growth(column, row)) * from_eye(view, column, row);
    }
    sum += CellSteps(corners).area();
  }
  return sum;
}

}  // namespace

SharpenedMaps sharpened_in_tiles(const ObjectView& view, std::span<const PhasedView> stations, int tile_px,
                                 const Context& context) {
  context.validate();
  view.validate();
  for (const PhasedView& station : stations) {
    station.view.validate();
    if (station.cosine.size() == station.view.camera.size && station.sine.size() == station.view.camera.size) continue;
    throw input_error(station.view.name + ": phases are " + to_string(station.cosine.size()) + " pixels, expected " +
                      to_string(station.view.camera.size));
  }
  const Size size = view.camera.size;
  const Image<double> growth = stations.empty() ? Image<double>(size) : growths(view, stations, tile_px, context);
  SharpenedMaps moved{Image<float>::uninitialized(size), Image<float>::uninitialized(size, 3)};
  parallel_pixels(context, size, [&](int u, int v) {
    moved.depth(u, v) = static_cast<float>(view.depth(u, v) * (1 + growth(u, v)));
    const Eigen::Vector3d sum = stations.empty() ? Eigen::Vector3d::Zero() : areas_about(view, growth, u, v);
    const Eigen::Vector3d normal = sum.isZero(0) ? normal_at(view, u, v) : sum.normalized();
    Eigen::Map<Eigen::Vector3f>(&moved.normals(u, v)) = normal.cast<float>();
  });
  return moved;
}

SharpenedMaps sharpened(const ObjectView& view, std::span<const PhasedView> stations, const Context& context) {
  return sharpened_in_tiles(view, stations, usual_tile_px, context);
}

}  // namespace malus
