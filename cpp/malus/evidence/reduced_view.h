#pragma once

#include <Eigen/Geometry>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/polarization/polarization_state.h"

namespace malus {

/// What the station's images show, in pixels of factor × factor of theirs.
struct SceneView {
  int factor = 1;
  Image<float> brightness;  ///< ln of the unpolarized intensity
  Mask seen;                ///< 255 where there is a brightness
  Image<float> s1, s2;      ///< mean (s1, s2) / s0 of the valid pixels; 0 = none
  Image<float> variance;    ///< of s1 and s2, by the noise model; 0 = none
  Mask object;              ///< 255 = most of the pixel is the object

  Size size() const { return brightness.size(); }
};

/// scene: unpolarized intensity of everything in view; empty = only the state's valid pixels are known. object: the
/// mask, of the state's size.
SceneView scene_view(const PolarizationState& state, const Image<float>& scene, const Mask& object, int factor);

/// A coarse surface as the station sees it, in the same pixels.
struct PriorView {
  Image<float> normals;     ///< 3 channels, unit, camera frame, towards the camera; NaN = none
  Image<float> brightness;  ///< ln of its color's mean, NaN = none; empty = the surface has no colors
  Mask seen;                ///< 255 = there is a surface
  Image<float> depth;       ///< z, NaN = none
  double median_depth = 0;
};

/// The camera whose pixels are factor × factor of this one's; what is left at the border is cut off.
Pinhole reduced_camera(const Pinhole& camera, int factor);

/// View of a cloud through a reduced camera. Points behind others or facing away are left out, where the cloud has
/// normals; without them the normals are those of the points' depths, smoothed. At most two million points, evenly
/// taken, are used. cam_from_cloud: any affine map.
PriorView prior_view(const PointCloud& cloud, const Pinhole& camera, const Eigen::Affine3d& cam_from_cloud);

/// View of a depth map of the full size (z, NaN = none), which has no colors.
PriorView prior_view(const Image<float>& depth, const Pinhole& camera, int factor, const Context& context);

}  // namespace malus
