#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <vector>

#include "malus/core/pixel_rect_internal.h"
#include "malus/linalg/grid_system_internal.h"
#include "malus/object/view.h"

namespace malus {

/// A corner of a cell of four pixels: its place from the first one, and its factors in the steps to the right and down
/// across the cell's middle.
struct CellCorner {
  int du, dv;
  double to_right, to_down;
};
inline constexpr std::array<CellCorner, 4> cell_corners{
    {{0, 0, -0.5, -0.5}, {1, 0, 0.5, -0.5}, {0, 1, -0.5, 0.5}, {1, 1, 0.5, 0.5}}};
using CellPoints = std::array<Eigen::Vector3d, 4>;

/// Steps across the middle of a cell.
struct CellSteps {
  Eigen::Vector3d right = Eigen::Vector3d::Zero(), down = Eigen::Vector3d::Zero();

  explicit CellSteps(const CellPoints& corners) {
    for (std::size_t k = 0; k < corners.size(); ++k) {
      right += cell_corners[k].to_right * corners[k];
      down += cell_corners[k].to_down * corners[k];
    }
  }
  /// Normal of the cell towards the eye, with the cell's area as its length.
  Eigen::Vector3d area() const { return down.cross(right); }
};

/// Whether the pixel, and those to the right, down and between these, are usable and belong to one surface.
bool is_cell(const ObjectView& view, int u, int v);

/// Vector from the eye to the surface's world point in a pixel.
Eigen::Vector3d from_eye(const ObjectView& view, int u, int v);

/// Part of a view's surface as cells of four neighboring pixels. The unknowns are the growths: each pixel's change of
/// depth over depth.
class SurfaceCells {
 public:
  SurfaceCells(const ObjectView& view, const PixelRect& window);

  const ObjectView& view() const { return *view_; }
  /// The pixels that belong to a cell, in the coordinates of the window.
  const PixelIndex& pixels() const { return pixels_; }
  int unknowns() const { return pixels_.count(); }
  /// Whether an unknown is the first corner of a cell.
  bool begins_cell(int unknown) const { return begins_cell_[static_cast<std::size_t>(unknown)] != 0; }
  /// The unknowns of the corners of the cell that begins here.
  std::array<int, 4> corner_unknowns(int unknown) const;
  /// Vectors from the eye to the corners of this cell after this growth.
  CellPoints corners(const std::array<int, 4>& unknowns, const Eigen::VectorXd& growth) const;

  /// Standard deviation of the pixel's position across the surface [GSD]. It is enlarged so that pixels with a common
  /// error together count as one measurement.
  double sigma(int unknown) const { return sigma_[static_cast<std::size_t>(unknown)]; }
  /// How far an unknown moves across the surface for a growth of one, in GSD.
  double across(int unknown) const { return across_[static_cast<std::size_t>(unknown)]; }

 private:
  const ObjectView* view_;
  PixelIndex pixels_;
  std::vector<std::uint8_t> begins_cell_;
  std::vector<Eigen::Vector3d> from_eye_;
  std::vector<double> sigma_, across_;
};

}  // namespace malus
