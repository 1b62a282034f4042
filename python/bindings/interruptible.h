#pragma once

#include <pybind11/pybind11.h>

#include <functional>
#include <optional>
#include <type_traits>
#include <utility>

#include "malus/core/context.h"

namespace malus::python {

namespace py = pybind11;

/// Runs a computation on a worker thread with the GIL released, while the calling thread delivers progress and log
/// events to the Python callbacks (either may be None) and watches for Ctrl-C, which cancels the computation through
/// its context. Exceptions of the computation, and of the callbacks, are rethrown here.
void run_interruptible(int threads, const py::object& on_progress, const py::object& on_log,
                       const std::function<void(const Context&)>& compute);

/// Runs a computation with run_interruptible, without callbacks, and returns its result.
template <class Compute>
auto computed(int threads, Compute&& compute) {
  std::optional<std::invoke_result_t<Compute, const Context&>> result;
  run_interruptible(threads, py::none(), py::none(), [&](const Context& context) { result.emplace(compute(context)); });
  return std::move(*result);
}

/// Lets other Python threads run during a function without a computation to cancel, such as one that writes a file. The
/// function must not touch Python objects.
using WithoutGil = py::call_guard<py::gil_scoped_release>;

}  // namespace malus::python
