#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "interruptible.h"
#include "malus/core/refractive_index_internal.h"
#include "malus/polarization/decompose_internal.h"
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
  static const std::string name = "refractive_index";  // once, not for every element of an array
  return accepted_refractive_index(eta, name);
}

/// Getter of a raster of a state. The array shares the state's memory.
template <class T>
auto raster(Image<T> PolarizationState::*member) {
  return [member](const py::object& self) { return view_of(self.cast<const PolarizationState&>().*member, self); };
}

}  // namespace

void bind_polarization(py::module_& module) {
  module.def("diffuse_degree",
             py::vectorize([](double zenith, double eta) { return diffuse_degree(zenith, accepted(eta)); }));
  module.def("specular_degree",
             py::vectorize([](double zenith, double eta) { return specular_degree(zenith, accepted(eta)); }));
  module.def("diffuse_zenith",
             py::vectorize([](double degree, double eta) { return diffuse_zenith(degree, accepted(eta)).zenith_rad; }));
  module.def("specular_zenith", py::vectorize([](double degree, double eta, bool above_brewster) {
               const auto branch = above_brewster ? SpecularBranch::above_brewster : SpecularBranch::below_brewster;
               return specular_zenith(degree, accepted(eta), branch).zenith_rad;
             }));
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

  py::class_<ReflectionMap>(module, "ReflectionMap")
      .def_readonly("label", &ReflectionMap::label)
      .def_readonly("zenith_rad", &ReflectionMap::zenith)
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
