#include <variant>

#include "malus/io/image_file_internal.h"
#include "malus/prior/shape_depth_internal.h"
#include "malus/station/check_inputs_internal.h"
#include "malus/station/check_picture_internal.h"
#include "malus/station/prior_scale_internal.h"

namespace malus {
namespace {

constexpr std::size_t most_points = 100000;

/// The prior's points in the world frame. A depth map is in the undistorted view.
struct PointsInView {
  const CameraSpec& camera;

  using Points = std::vector<Eigen::Vector3d>;

  Points operator()(std::monostate) const { return {}; }
  Points operator()(PointCloud cloud) const { return std::move(cloud.points); }
  Points operator()(TriangleMesh mesh) const { return std::move(mesh.vertices.points); }
  Points operator()(const Shape& shape) const {
    return (*this)(depth_of_shape(shape, camera.lens.pinhole(), camera.pose));
  }
  Points operator()(const SweptDepth& swept) const { return (*this)(swept.depth); }
  Points operator()(const Image<float>& depth) const { return points_of_depth(depth, camera); }
};

Image<float> mean_of_channels(const Image<float>& image) {
  Image<float> mean(image.size());
  const auto channels = static_cast<std::size_t>(image.channels());
  for (std::size_t i = 0; i < mean.count(); ++i) {
    for (std::size_t c = 0; c < channels; ++c) mean[i] += image[i * channels + c] / static_cast<float>(channels);
  }
  return mean;
}

}  // namespace

CheckPicture check_picture(const Station& station, const Context& context) {
  CheckPicture picture;
  picture.image = mean_of_channels(station.in_memory() ? station.images.front()
                                                       : read_image(station.file.polarized.images.front()).pixels);
  picture.object = captured_object(station, picture.image.size());
  if (!station.file.camera) return picture;
  const CameraSpec& camera = *station.file.camera;
  const auto points = with_prior(station, context, PointsInView{camera});
  for (const SeenPoint& point : seen_points(points, camera, picture.image.size(), context, most_points)) {
    picture.points.emplace_back(static_cast<float>(point.u), static_cast<float>(point.v),
                                static_cast<float>(point.in_cam.z()));
  }
  return picture;
}

}  // namespace malus
