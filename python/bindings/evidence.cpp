#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <cmath>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "clouds.h"
#include "interruptible.h"
#include "malus/core/fields.h"
#include "malus/evidence/before_fusion_internal.h"
#include "malus/evidence/image_order_internal.h"
#include "malus/evidence/object_size_internal.h"
#include "malus/evidence/response_check_internal.h"

namespace malus::python {
namespace {

py::dict to_dict(const Finding& finding) {
  py::dict figures;
  for (const auto& [name, value] : finding.figures) figures[py::str(name)] = value;
  py::dict result;
  result["check"] = finding.check;
  result["severity"] = std::string(enum_name(finding.severity));
  result["message"] = finding.message;
  result["suggestion"] = finding.suggestion;
  result["figures"] = figures;
  return result;
}

/// H×W×4 of the parts: u, v, disagreement, its standard deviation.
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

/// What a call of check_prior is given besides the prior.
struct SceneArrays {
  Image<float> scene;
  Mask object;

  SceneArrays(const PolarizationState& state, const std::optional<Array<float>>& scene_array,
              const std::optional<Array<std::uint8_t>>& mask_array)
      : scene(scene_array ? to_image(*scene_array) : Image<float>()),
        object(mask_array ? to_image(*mask_array) : Mask(state.size(), 1, 255)) {}
};

std::vector<Image<float>> to_images(const std::vector<Array<float>>& arrays) {
  std::vector<Image<float>> images;
  for (const auto& array : arrays) images.push_back(to_image(array));
  return images;
}

py::dict to_dict(const PriorAlignment& alignment) {
  py::dict result = to_dict(alignment.finding);
  result["instead"] = alignment.instead;
  return result;
}

}  // namespace

void bind_evidence(py::module_& module) {
  module.def("check_phase", [](const PolarizationState& state, const std::optional<RasterView>& view,
                               const Array<float>& normals_array, int threads) {
    const Image<float> normals = to_image(normals_array);
    PhaseAgreement agreement;
    run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
      agreement = phase_agreement(state, view ? &view->camera : nullptr, normals, context);
    });
    py::dict result = to_dict(agreement.finding);
    result["parts"] = parts_array(agreement);
    return result;
  });

  module.def("check_cloud", [](const Array<double>& points, const std::optional<Array<float>>& normals,
                               const std::optional<Array<std::uint8_t>>& colors, const PolarizationState& state,
                               const std::optional<Array<float>>& scene, const std::optional<Array<std::uint8_t>>& mask,
                               const RasterView& view, const std::string& unit, int threads) {
    PointCloud cloud = to_cloud(points);
    for (std::size_t i = 0; normals && i < cloud.points.size(); ++i)
      cloud.normals.emplace_back(normals->data()[3 * i], normals->data()[3 * i + 1], normals->data()[3 * i + 2]);
    for (std::size_t i = 0; colors && i < cloud.points.size(); ++i)
      cloud.colors.push_back({colors->data()[3 * i], colors->data()[3 * i + 1], colors->data()[3 * i + 2]});
    const SceneArrays arrays(state, scene, mask);
    PriorAlignment alignment;
    run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
      alignment = check_alignment(cloud, view.pose, {state, arrays.scene, arrays.object, view.camera, unit}, context);
    });
    return to_dict(alignment);
  });

  module.def("check_depth", [](const Array<float>& depth_array, const PolarizationState& state,
                               const std::optional<Array<float>>& scene, const std::optional<Array<std::uint8_t>>& mask,
                               const RasterView& view, const std::string& unit, int threads) {
    const Image<float> depth = to_image(depth_array);
    const SceneArrays arrays(state, scene, mask);
    PriorAlignment alignment;
    run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
      alignment = check_alignment(depth, {state, arrays.scene, arrays.object, view.camera, unit}, context);
    });
    return to_dict(alignment);
  });

  module.def("check_size", [](const Array<double>& points_in_cam, const RasterView& view, const std::string& unit) {
    return to_dict(object_size(to_cloud(points_in_cam).points, view.camera, unit).finding);
  });

  module.def("check_order", [](const std::vector<Array<float>>& arrays, const std::vector<double>& angles_rad,
                               const std::optional<Array<std::uint8_t>>& mask_array) {
    const Mask mask = mask_array ? to_image(*mask_array) : Mask();
    const ImageOrder order = check_image_order(to_images(arrays), angles_rad, mask, {});
    py::dict result = to_dict(order.finding);
    result["angles_rad"] = order.angles_rad;
    return result;
  });

  module.def("check_response", [](const std::vector<Array<float>>& arrays, const std::vector<double>& angles_rad,
                                  const std::optional<Array<std::uint8_t>>& mask_array, const std::string& response) {
    const Mask mask = mask_array ? to_image(*mask_array) : Mask();
    return to_dict(check_response(to_images(arrays), angles_rad, mask, response, {}).finding);
  });
}

}  // namespace malus::python
