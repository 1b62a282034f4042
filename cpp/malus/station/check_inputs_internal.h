#pragma once

// Private to the station room: data of a station that a check reads before anything is computed.

#include <Eigen/Core>
#include <cstddef>
#include <limits>
#include <vector>

#include "malus/capture/capture_internal.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/station/station.h"

namespace malus {

/// Input that reads the station's files, or its images in memory; the station must outlive it.
CaptureInput make_capture_input(const Station& station);

/// Size of the polarized images as taken.
Size captured_size(const Station& station);

/// Mask of the object in the images as taken; without a mask file, all pixels.
Mask captured_object(const Station& station, Size size);

/// Labels of the images as taken; empty without any. Input error for labels of another size than the images or with
/// other values than 0, 1 and 2, and for the label.png of a run if the lens has distortion: a run writes labels of the
/// undistorted view, which would be undistorted once more.
Mask captured_labels(const Station& station);

/// The labels in the undistorted view; empty without any.
Mask labels_in_view(const Station& station, const Context& context);

/// Lens and pose. Input error without a pose.
const CameraSpec& require_camera(const StationFile& station);

/// A point of the prior projected into the station's camera.
struct SeenPoint {
  Eigen::Vector3d in_cam;
  double u = 0, v = 0;  ///< in the image as taken, inside it
};

/// Those of the points (world frame) that lie in front of the camera and that its lens sees in the image, in their
/// order; of more than `most`, every k-th.
std::vector<SeenPoint> seen_points(const std::vector<Eigen::Vector3d>& points, const CameraSpec& camera, Size image,
                                   const Context& context, std::size_t most = std::numeric_limits<std::size_t>::max());

/// World points of a depth map in the station's undistorted view: pixels that have a depth, in rows and columns about
/// `stride` apart from the first to the last one.
std::vector<Eigen::Vector3d> points_of_depth(const Image<float>& depth, const CameraSpec& camera, int stride = 1);

}  // namespace malus
