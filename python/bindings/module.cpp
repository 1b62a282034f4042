#include <pybind11/pybind11.h>

#include <filesystem>
#include <new>
#include <string>
#include <system_error>

#include "bindings.h"
#include "malus/core/error.h"
#include "malus/core/version.h"

namespace py = pybind11;

namespace {

/// Name of the exception in malus.errors for an error code; nullptr for KeyboardInterrupt.
const char* exception_name(malus::ErrorCode code) {
  switch (code) {
    case malus::ErrorCode::input:
      return "InputError";
    case malus::ErrorCode::data:
      return "DataError";
    case malus::ErrorCode::external:
      return "ExternalError";
    case malus::ErrorCode::resource:
      return "ResourceError";
    case malus::ErrorCode::interrupted:
      break;
  }
  return nullptr;
}

/// Raises an exception of malus.errors. File names in the message need not be UTF-8.
void raise(const char* name, const std::string& message) {
  const py::object type = py::module_::import("malus.errors").attr(name);
  const auto text = py::reinterpret_steal<py::object>(
      PyUnicode_DecodeUTF8(message.data(), static_cast<py::ssize_t>(message.size()), "backslashreplace"));
  PyErr_SetObject(type.ptr(), text.ptr());
}

void translate(std::exception_ptr error) {
  try {
    if (error) std::rethrow_exception(error);
  } catch (const malus::Error& e) {
    const char* name = exception_name(e.code());
    if (name == nullptr) {
      PyErr_SetString(PyExc_KeyboardInterrupt, e.what());
    } else {
      raise(name, e.what());
    }
  } catch (const std::filesystem::filesystem_error& e) {
    raise("InputError", e.path1().string() + ": " + e.code().message());
  } catch (const std::system_error& e) {
    raise("ResourceError", std::string("the system refuses: ") + e.what());
  } catch (const std::bad_alloc&) {
    PyErr_SetString(PyExc_MemoryError, "out of memory");
  }
}

}  // namespace

PYBIND11_MODULE(_core, module) {
  module.doc() = "Private extension of malus; use the package's own modules.";
  module.attr("version") = malus::version;
  py::register_exception_translator(&translate);
  malus::python::bind_io(module);
  malus::python::bind_capture(module);
  malus::python::bind_polarization(module);
  malus::python::bind_evidence(module);
  malus::python::bind_photogrammetry(module);
  malus::python::bind_prior(module);
  malus::python::bind_stereo(module);
  malus::python::bind_height(module);
  malus::python::bind_fusion(module);
  malus::python::bind_surface(module);
  malus::python::bind_object(module);
  malus::python::bind_assess(module);
  malus::python::bind_station(module);
}
