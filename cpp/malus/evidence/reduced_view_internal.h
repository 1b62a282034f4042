#pragma once

#include <Eigen/Geometry>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/evidence/prior_alignment_internal.h"

namespace malus {

/// The station's images at reduced size: each pixel covers factor × factor pixels of the images.
struct SceneView {
  int factor = 1;
  Pinhole camera;           ///< of this view
  Image<float> brightness;  ///< ln of the unpolarized intensity
  Mask seen;                ///< 255 where the brightness is known
  Image<float> s1, s2;      ///< mean (s1, s2) / s0 of the valid pixels; 0 = none
  Image<float> variance;    ///< of s1 and s2, by the noise model; 0 = none
  Mask object;              ///< 255 = most of the pixel is the object

  Size size() const { return brightness.size(); }
};

SceneView scene_view(const AlignmentScene& images, int factor, const Context& context);

/// The prior surface as the station sees it, in the same pixels as SceneView.
struct PriorView {
  Image<float> normals;     ///< 3 channels, unit, camera frame, towards the camera; NaN = none
  Image<float> brightness;  ///< ln of the mean of the color's channels, NaN = none; empty = the surface has no colors
  Mask seen;                ///< 255 where the surface is known
  Image<float> depth;       ///< z, NaN = none
  double median_depth = 0;
};

/// The camera whose pixels each cover factor × factor pixels of this one; incomplete pixels at the border are cut off,
/// except in an image that is narrower than one pixel.
Pinhole reduced_camera(const Pinhole& camera, int factor);

/// View of a cloud through a reduced camera. Points hidden behind others are left out and, if the cloud has normals,
/// points facing away. Where the cloud has no normals, or zeros, they are those of its smoothed depths. At most two
/// million evenly sampled points are used. cam_from_cloud: any affine map.
PriorView prior_view(const PointCloud& cloud, const Pinhole& camera, const Eigen::Affine3d& cam_from_cloud);

/// View of a depth map of the full size (z, NaN = none), which has no colors.
PriorView prior_view(const Image<float>& depth, const Pinhole& camera, int factor, const Context& context);

}  // namespace malus
