#include <Eigen/Geometry>

#include "malus/io/image_file_internal.h"
#include "malus/station/check_inputs_internal.h"

namespace malus {

Size captured_size(const Station& station) {
  if (station.in_memory()) return station.images.front().size();
  if (station.file.polarized.images.empty()) throw input_error("no polarized images");
  return read_image_size(station.file.polarized.images.front());
}

Mask captured_object(const Station& station, Size size) {
  if (station.mask) {
    require_size(*station.mask, size, "mask");
    return *station.mask;
  }
  if (!station.file.polarized.mask) return Mask(size, 1, 255);
  Mask mask = read_mask(*station.file.polarized.mask);
  require_size(mask, size, station.file.polarized.mask->string());
  return mask;
}

std::vector<SeenPoint> seen_points(const std::vector<Eigen::Vector3d>& points, const CameraSpec& camera, Size image) {
  constexpr double same_direction = 1e-6;
  const bool has_distortion = camera.lens.has_distortion();
  std::vector<SeenPoint> found;
  for (const Eigen::Vector3d& point : points) {
    const Eigen::Vector3d x = camera.pose.cam_from_world(point);
    if (!(x.z() > 0)) continue;
    const Eigen::Vector2d ideal = x.hnormalized();
    const Eigen::Vector2d pixel = camera.lens.distort(ideal);
    if (!(pixel.minCoeff() > -0.5 && pixel.x() < image.width - 0.5 && pixel.y() < image.height - 0.5)) continue;
    // Far outside of the view the polynomials of a lens bend back: they send the room beside an object into its image.
    if (has_distortion && !((camera.lens.undistort(pixel) - ideal).norm() < same_direction)) continue;
    found.push_back({x, pixel.x(), pixel.y()});
  }
  return found;
}

}  // namespace malus
