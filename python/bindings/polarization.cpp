#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <utility>
#include <vector>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "interruptible.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/refractive_index_internal.h"
#include "malus/polarization/decompose_internal.h"
#include "malus/polarization/frame_calibration_internal.h"
#include "malus/polarization/fresnel.h"
#include "malus/polarization/polarizer_fit_internal.h"
#include "malus/polarization/reflection_internal.h"
#include "words.h"

namespace malus::python {
namespace {

template <class Sample>
PolarizationState decompose_arrays(const std::vector<Array<Sample>>& arrays, const std::vector<double>& angles_rad,
                                   const Mask& mask, double full_well_e, double read_noise_e, int frames_averaged,
                                   const Options& options, int threads) {
  std::vector<const Sample*> images;
  for (const auto& array : arrays) images.push_back(array.data());
  const Size size{static_cast<int>(arrays.at(0).shape(1)), static_cast<int>(arrays.at(0).shape(0))};
  return computed(threads, [&](const Context& context) {
    return decompose(size, std::span<const Sample* const>(images), angles_rad,
                     {full_well_e, read_noise_e, 0, frames_averaged}, mask, {}, options.polarization, context);
  });
}

/// Binds decompose for images of one sample type.
template <class Sample>
void bind_decompose(py::module_& module, const char* name) {
  module.def(name, &decompose_arrays<Sample>, py::arg("images"), py::arg("angles_rad"), py::arg("mask"),
             py::arg("full_well_e"), py::arg("read_noise_e"), py::arg("frames_averaged"), py::arg("options"),
             py::arg("threads"));
}

double accepted(double eta) {
  return accepted_refractive_index(eta, "refractive_index");
}

/// function(x) of every element of an array of any shape, as an array of this shape; a number if there are no axes.
template <class Function>
py::object of_each_element(const Array<double>& values, const Function& function) {
  py::array_t<double> results(std::vector<py::ssize_t>(values.shape(), values.shape() + values.ndim()));
  const double* const from = values.data();
  double* const to = results.mutable_data();
  const auto count = static_cast<std::size_t>(values.size());
  const auto compute = [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) to[i] = function(from[i]);
  };
  constexpr std::size_t at_once = 1 << 16;  // takes a few milliseconds, less than a thread is worth
  if (count <= at_once) {
    compute(0, count);
  } else {
    run_interruptible(1, py::none(), py::none(),
                      [&](const Context& context) { parallel_for(context, count, at_once, compute); });
  }
  if (values.ndim() == 0) return py::float_(*to);
  return results;
}

/// The state, corrected if a surface's azimuths contradict the zero of the polarizer's scale, and the figures of that.
std::pair<PolarizationState, py::object> calibrated_with_surface(
    const PolarizationState& state, const std::optional<RasterView>& view, const Image<float>& normals,
    const std::optional<Eigen::Vector3d>& light, bool known_scale, const std::string& reflection,
    double refractive_index, const Options& options, int threads) {
  FrameHints hints;
  hints.known_scale = known_scale;
  const ReflectionChoice choice = reflection_choice(reflection, false);
  if (choice != ReflectionChoice::automatic) hints.specular = choice == ReflectionChoice::specular;
  hints.refractive_index = accepted(refractive_index);
  hints.light = light;
  PolarizationState corrected = state;
  const PolarizerCalibration found = computed(threads, [&](const Context& context) {
    const PolarizerFit given = polarizer_as_given(state.angles_rad, options.polarizer);
    const FrameEstimate surface =
        estimate_frame(state, view ? &view->camera : nullptr, normals, hints, options.polarizer, context);
    CalibratedFrame result = calibrate_frame(given, false, known_scale, surface, options.polarizer);
    if (result.calibration.from_surface) apply_frame(corrected, result.frame, context);
    return result.calibration;
  });
  return {std::move(corrected), by_fields(found)};
}

}  // namespace

void bind_polarization(py::module_& module) {
  module.def("diffuse_degree", [](const Array<double>& zeniths, double refractive_index) {
    const double eta = accepted(refractive_index);
    return of_each_element(zeniths, [eta](double zenith) { return diffuse_degree(zenith, eta); });
  });
  module.def("specular_degree", [](const Array<double>& zeniths, double refractive_index) {
    const double eta = accepted(refractive_index);
    return of_each_element(zeniths, [eta](double zenith) { return specular_degree(zenith, eta); });
  });
  module.def("diffuse_zenith", [](const Array<double>& degrees, double refractive_index) {
    const double eta = accepted(refractive_index);
    return of_each_element(degrees, [eta](double degree) { return diffuse_zenith(degree, eta).zenith_rad; });
  });
  module.def("specular_zenith", [](const Array<double>& degrees, double refractive_index, bool above_brewster) {
    const double eta = accepted(refractive_index);
    const auto branch = above_brewster ? SpecularBranch::above_brewster : SpecularBranch::below_brewster;
    return of_each_element(degrees,
                           [eta, branch](double degree) { return specular_zenith(degree, eta, branch).zenith_rad; });
  });
  module.def("brewster_angle", [](double eta) { return brewster_angle(accepted(eta)); });

  py::class_<PolarizationState>(module, "PolarizationState")
      .def_property_readonly("unpolarized", raster(&PolarizationState::i_un))
      .def_property_readonly("degree", raster(&PolarizationState::rho))
      .def_property_readonly("phase_rad", raster(&PolarizationState::phi))
      .def_property_readonly("residual", raster(&PolarizationState::residual))
      .def_property_readonly("valid", raster(&PolarizationState::valid))
      .def_property_readonly("angles_rad", [](const PolarizationState& s) { return s.angles_rad; })
      .def_property_readonly("exposures", [](const PolarizationState& s) { return s.exposures; });
  bind_decompose<float>(module, "decompose");
  bind_decompose<std::uint16_t>(module, "decompose_16_bit");

  module.def("fit_polarizer",
             [](const std::vector<Image<float>>& images, const std::vector<double>& nominal_rad, const Mask& mask,
                double full_well_e, double read_noise_e, int frames_averaged, const Options& options, int threads) {
               const NoiseModel noise{full_well_e, read_noise_e, 0, frames_averaged};
               const PolarizerFit fit = computed(threads, [&](const Context& context) {
                 return fit_polarizer(images, nominal_rad, noise, mask, {}, options.polarizer, context);
               });
               py::dict result;
               result["angles_rad"] = fit.angles_rad;
               result["gains"] = fit.gains;
               result["residual_before"] = fit.residual_before;
               result["residual_after"] = fit.residual_after;
               result["improvement"] = fit.improvement();
               return result;
             });

  module.def("calibrate_with_surface", &calibrated_with_surface);

  py::class_<ReflectionMap>(module, "ReflectionMap")
      .def_property_readonly("label", raster(&ReflectionMap::label))
      .def_property_readonly("zenith_rad", raster(&ReflectionMap::zenith))
      .def_readonly("specular_share", &ReflectionMap::specular_share)
      .def_readonly("clamped_share", &ReflectionMap::clamped_share);
  module.def("map_reflection",
             [](const PolarizationState& state, const std::optional<RasterView>& view,
                const std::optional<Image<float>>& normals, double refractive_index, const std::string& reflection,
                const std::optional<Mask>& labels, const Options& all_options, int threads) {
               ReflectionOptions options = all_options.reflection;
               options.refractive_index = refractive_index;
               options.reflection = reflection_choice(reflection, labels.has_value());
               return computed(threads, [&](const Context& context) {
                 return map_reflection(state, view ? &view->camera : nullptr, normals ? &*normals : nullptr,
                                       labels ? &*labels : nullptr, options, context);
               });
             });
}

}  // namespace malus::python
