#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "clouds.h"
#include "interruptible.h"
#include "malus/evidence/before_fusion_internal.h"
#include "malus/evidence/image_order_internal.h"
#include "malus/evidence/object_size_internal.h"
#include "malus/evidence/response_check_internal.h"
#include "words.h"

namespace malus::python {
namespace {

/// An H×W×4 array of the parts of the image: u, v, disagreement, standard deviation of the disagreement.
py::array_t<double> parts_array(const PhaseAgreement& agreement) {
  constexpr py::ssize_t side = PhaseAgreement::parts_per_side;
  py::array_t<double> array({side, side, py::ssize_t{4}});
  auto values = array.mutable_unchecked<3>();
  for (py::ssize_t i = 0; i < side * side; ++i) {
    const PhaseAgreement::Part& part = agreement.parts[static_cast<std::size_t>(i)];
    values(i / side, i % side, 0) = part.u;
    values(i / side, i % side, 1) = part.v;
    values(i / side, i % side, 2) = part.disagreement;
    values(i / side, i % side, 3) = part.disagreement_sigma;
  }
  return array;
}

py::dict to_dict(const PriorAlignment& alignment) {
  py::dict result = by_fields(alignment.finding);
  result["instead"] = alignment.instead;
  return result;
}

}  // namespace

void bind_evidence(py::module_& module) {
  module.def("check_phase", [](const PolarizationState& state, const std::optional<RasterView>& view,
                               const Image<float>& normals, int threads) {
    const PhaseAgreement agreement = computed(threads, [&](const Context& context) {
      return phase_agreement(state, view ? &view->camera : nullptr, normals, context);
    });
    py::dict result = by_fields(agreement.finding);
    result["parts"] = parts_array(agreement);
    return result;
  });

  module.def("check_cloud", [](const Array<double>& points, const std::optional<Array<float>>& normals,
                               const std::optional<Array<std::uint8_t>>& colors, const PolarizationState& state,
                               const std::optional<Image<float>>& scene, const Mask& mask, const RasterView& view,
                               const std::string& unit, int threads) {
    const PointCloud cloud = to_cloud(points, normals, colors);
    const Image<float> picture = scene.value_or(Image<float>());
    return to_dict(computed(threads, [&](const Context& context) {
      return check_alignment(cloud, view.pose, {state, picture, mask, view.camera, unit}, context);
    }));
  });

  module.def("check_depth",
             [](const Image<float>& depth, const PolarizationState& state, const std::optional<Image<float>>& scene,
                const Mask& mask, const RasterView& view, const std::string& unit, int threads) {
               const Image<float> picture = scene.value_or(Image<float>());
               return to_dict(computed(threads, [&](const Context& context) {
                 return check_alignment(depth, {state, picture, mask, view.camera, unit}, context);
               }));
             });

  module.def("check_size", [](const Array<double>& points_in_cam, const RasterView& view, const std::string& unit) {
    const PointCloud cloud = to_cloud(points_in_cam);
    return by_fields(computed(1, [&](const Context&) { return object_size(cloud.points, view.camera, unit); }).finding);
  });

  module.def("check_order",
             [](const std::vector<Image<float>>& images, const std::vector<double>& angles_rad, const Mask& mask) {
               const ImageOrder order = computed(
                   1, [&](const Context& context) { return check_image_order(images, angles_rad, mask, context); });
               py::dict result = by_fields(order.finding);
               result["angles_rad"] = order.angles_rad;
               return result;
             });

  module.def("check_response", [](const std::vector<Image<float>>& images, const std::vector<double>& angles_rad,
                                  const Mask& mask, const std::string& response) {
    const Response stated = stated_response(response);
    return by_fields(computed(1, [&](const Context& context) {
                       return check_response(images, angles_rad, mask, stated, context);
                     }).finding);
  });
}

}  // namespace malus::python
