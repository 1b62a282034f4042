#pragma once

#include <pybind11/pybind11.h>

namespace malus::python {

// One source a room of the library; each adds its functions to the extension.
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
void bind_assess(pybind11::module_& module);
void bind_station(pybind11::module_& module);

}  // namespace malus::python
