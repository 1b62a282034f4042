#include <Eigen/Geometry>
#include <cmath>
#include <filesystem>
#include <optional>

#include "malus/capture/capture_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/spread_pixels_internal.h"
#include "malus/io/image_file_internal.h"
#include "malus/polarization/reflection_internal.h"
#include "malus/station/check_inputs_internal.h"

namespace malus {
namespace {

/// What `choose(element, take)` takes from the elements, in their order.
template <class Element, class Choose>
std::vector<SeenPoint> chosen(const std::vector<Element>& elements, const Context& context, Choose&& choose) {
  constexpr std::size_t block = 1 << 14;
  std::vector<std::vector<SeenPoint>> parts((elements.size() + block - 1) / block);
  parallel_for(context, elements.size(), block, [&](std::size_t begin, std::size_t end) {
    std::vector<SeenPoint>& part = parts[begin / block];
    const auto take = [&](const SeenPoint& point) { part.push_back(point); };
    for (std::size_t i = begin; i < end; ++i) choose(elements[i], take);
  });
  std::vector<SeenPoint> all;
  for (const std::vector<SeenPoint>& part : parts) all.insert(all.end(), part.begin(), part.end());
  return all;
}

}  // namespace

CaptureInput make_capture_input(const Station& station) {
  const std::optional<LensCamera> lens = station.file.known_lens();
  if (!station.in_memory()) return capture_input(station.file.polarized, lens);
  CaptureInput input;
  input.polarized = station.file.polarized;
  input.lens = lens;
  input.mask = station.mask;
  for (std::size_t k = 0; k < station.images.size(); ++k) input.names.push_back("images[" + std::to_string(k) + "]");
  input.load = [&station](std::size_t k) {
    // Whole numbers are treated like those of a file of 16 bits.
    return RawImage{station.images[k], station.whole_numbers ? 16 : 32};
  };
  return input;
}

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
  require_size_of_images(mask, size, "mask " + station.file.polarized.mask->string());
  return mask;
}

Mask captured_labels(const Station& station) {
  if (station.labels) {
    require_labels(*station.labels, captured_size(station));
    return *station.labels;
  }
  if (!station.file.optics.label_image) return {};
  const std::filesystem::path& path = *station.file.optics.label_image;
  const std::optional<LensCamera> lens = station.file.known_lens();
  const bool is_of_run =
      path.filename() == "label.png" && std::filesystem::exists(path.parent_path().parent_path() / "manifest.json");
  if (is_of_run && lens && lens->has_distortion()) {
    throw input_error("[optics].reflection = " + path.string() +
                      " is of a run, in the view without lens distortion; expected labels of the images as taken");
  }
  Mask labels = read_labels(path);
  require_labels(labels, captured_size(station), "label image " + path.string());
  return labels;
}

Mask labels_in_view(const Station& station, const Context& context) {
  const Mask labels = captured_labels(station);
  return labels.empty() ? labels : undistorted_mask(labels, station.file.known_lens(), context);
}

const CameraSpec& require_camera(const StationFile& station) {
  if (station.camera) return *station.camera;
  throw input_error(
      station.where() +
      ": [camera] has no pose, expected a camera whose position is known (a COLMAP model, or qvec and tvec)");
}

std::vector<SeenPoint> seen_points(const std::vector<Eigen::Vector3d>& points, const CameraSpec& camera, Size image,
                                   const Context& context, std::size_t most) {
  std::vector<SeenPoint> found = chosen(points, context, [&](const Eigen::Vector3d& point, auto&& take) {
    const Eigen::Vector3d x = camera.pose.cam_from_world(point);
    if (!(x.z() > 0)) return;
    const Eigen::Vector2d pixel = camera.lens.distort(x.hnormalized());
    if (!(pixel.minCoeff() > -0.5 && pixel.x() < image.width - 0.5 && pixel.y() < image.height - 0.5)) return;
    take({x, pixel.x(), pixel.y()});
  });
  if (const std::size_t stride = found.size() / most + 1; stride > 1) {
    for (std::size_t i = 0; i * stride < found.size(); ++i) found[i] = found[i * stride];
    found.resize((found.size() + stride - 1) / stride);
  }
  if (!camera.lens.has_distortion()) return found;
  // Far outside of the view the polynomials of a lens bend back: they send the room beside an object into its image.
  return chosen(found, context, [&](const SeenPoint& point, auto&& take) {
    constexpr double same_direction = 1e-6;
    const Eigen::Vector2d back = camera.lens.undistort({point.u, point.v});
    if ((back - point.in_cam.hnormalized()).norm() < same_direction) take(point);
  });
}

std::vector<Eigen::Vector3d> points_of_depth(const Image<float>& depth, const CameraSpec& camera, int stride) {
  const Pinhole pinhole = camera.lens.pinhole();
  std::vector<Eigen::Vector3d> points;
  for_each_spread({0, 0, depth.width(), depth.height()}, stride, [&](int u, int v) {
    if (depth(u, v) > 0 && std::isfinite(depth(u, v)))
      points.push_back(camera.pose.world_from_cam(depth(u, v) * pinhole.ray(u, v)));
  });
  return points;
}

}  // namespace malus
