#pragma once

#include "malus/core/image.h"

namespace malus {

/// Depths of the nearest points in each cell of an image, and the number of points, of the points that face the camera
/// and of those that face away.
///
/// The front of an object hides its back. If the normals point inwards, the front faces away and the back seems to face
/// the camera, so that the back would pass for the visible surface.
class FacingDepths {
 public:
  explicit FacingDepths(Size size);

  /// Adds a point at the pixel (u, v) of the image.
  void add(int u, int v, double depth, bool faces);
  void add(const FacingDepths& other);
  /// Whether points that face away lie in front of those that face the camera nearly everywhere. `focal`: in pixels.
  bool are_reversed(double focal) const;
  /// Share of the occupied cells in which every point faces away; cells are so large that most have several points.
  /// Near zero for a closed object with right normals, because each cell also has points of its front; 0 if there are
  /// too few points.
  double away_only() const;

 private:
  int cell_px_;
  Image<float> facing_, away_;            ///< depth in each cell; infinite = no point
  Image<int> facing_count_, away_count_;  ///< points in each cell
};

}  // namespace malus
