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
  /// Share of the cells with points in which all points face away, in cells so large that most have several points; 0
  /// if the points are too few to tell. Of a closed object each cell has points of the front, too.
  double away_only() const;

 private:
  int cell_px_;
  Image<float> facing_, away_;            ///< depth in each cell; infinite = no point
  Image<int> facing_count_, away_count_;  ///< points in each cell
};

}  // namespace malus
