#pragma once

#include <pybind11/pybind11.h>

namespace malus::python {

// Each room of the library has one source file here, whose function adds the bindings to the extension.
void bind_io(pybind11::module_& module);
void bind_capture(pybind11::module_& module);
void bind_polarization(pybind11::module_& module);
void bind_evidence(pybind11::module_& module);
void bind_photogrammetry(pybind11::module_& module);
void bind_prior(pybind11::module_& module);
void bind_stereo(pybind11::module_& module);
void bind_height(pybind11::module_& module);
void bind_fusion(pybind11::module_& module);
void bind_surface(pybind11::module_& module);
void bind_object(pybind11::module_& module);
void bind_assess(pybind11::module_& module);
void bind_station(pybind11::module_& module);

}  // namespace malus::python
