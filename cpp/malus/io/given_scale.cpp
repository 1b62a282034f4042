#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <sstream>

#include "malus/core/error.h"
#include "malus/io/given_scale_internal.h"

namespace malus {
namespace {

void require_in_image(const ImageMark& mark, Size size, const std::string& where) {
  if (mark.x >= -0.5 && mark.y >= -0.5 && mark.x <= size.width - 0.5 && mark.y <= size.height - 0.5) return;
  std::ostringstream message;
  message << where << ": its mark x = " << mark.x << ", y = " << mark.y << " lies outside of " << mark.image
          << ", which has " << to_string(size) << " pixels";
  throw input_error(message.str());
}

/// Point nearest to the rays of all marks.
Eigen::Vector3d meeting_point(const std::vector<ImageMark>& marks, const ColmapModel& model, const std::string& where) {
  constexpr double least_parallax = 1e-5;  // smallest over largest eigenvalue: rays within about half a degree
  Eigen::Matrix3d matrix = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  for (const ImageMark& mark : marks) {
    const ColmapImage& image = model.image(mark.image, where);
    const LensCamera& camera = model.cameras.at(image.camera_id);
    require_in_image(mark, camera.size, where);
    const Eigen::Vector2d ideal = camera.undistort({mark.x, mark.y});
    if (!ideal.allFinite())
      throw input_error(where + ": the lens of " + mark.image +
                        " sends no ray to its mark: so far out its distortion bends back");
    const Eigen::Vector3d ray =
        (image.pose.rotation.transpose() * Eigen::Vector3d(ideal.x(), ideal.y(), 1)).normalized();
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - ray * ray.transpose();
    matrix += across;
    right += across * image.pose.center();
  }
  const Eigen::Vector3d values = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(matrix).eigenvalues();
  if (!(values[0] > least_parallax * values[2]))
    throw input_error(where + ": the rays of its marks are parallel, expected images from different sides");
  const Eigen::Vector3d point = matrix.ldlt().solve(right);
  for (const ImageMark& mark : marks) {
    if (!(model.image(mark.image, where).pose.cam_from_world(point).z() > 0))
      throw input_error(where + ": the rays of its marks meet behind " + mark.image +
                        "; is the same point marked in every image?");
  }
  return point;
}

double measured_distance(const ScaleBar& bar, const ColmapModel* model, const std::string& where) {
  if (bar.a_xyz) {
    const Eigen::Vector3d a(bar.a_xyz->data()), b(bar.b_xyz->data());
    return (a - b).norm();
  }
  if (model == nullptr)
    throw input_error(where +
                      ": marks need the cameras of their images, expected [camera].colmap_model; or give a_xyz "
                      "and b_xyz, points in the prior's frame");
  return (meeting_point(bar.a, *model, where) - meeting_point(bar.b, *model, where)).norm();
}

}  // namespace

GivenScale given_scale(const std::vector<ScaleBar>& bars, const ColmapModel* model, const std::string& where) {
  std::vector<double> measured;
  double product = 0, square = 0;
  for (std::size_t i = 0; i < bars.size(); ++i) {
    const std::string bar = where + " " + std::to_string(i + 1);
    measured.push_back(measured_distance(bars[i], model, bar));
    if (!(measured.back() > 0)) throw input_error(bar + ": its two ends are one point");
    if (bars[i].check) continue;
    product += bars[i].distance * measured.back();
    square += measured.back() * measured.back();
  }
  if (square == 0)
    throw input_error(where + ": every bar has check = true, expected at least one that gives the scale");
  GivenScale scale;
  scale.factor = product / square;
  for (std::size_t i = 0; i < bars.size(); ++i) scale.errors.push_back(scale.factor * measured[i] - bars[i].distance);
  return scale;
}

}  // namespace malus
