#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "malus/assess/patches.h"

namespace malus::python {

void bind_assess(py::module_& module) {
  module.def("fit_patch",
             [](const Array<float>& depth_array, const RasterView& view, int x0, int y0, int x1, int y1,
                double gsd) -> py::object {
               const auto fit = fit_patch(to_image(depth_array), view.camera, {"patch", x0, y0, x1, y1}, gsd, {}, {});
               if (!fit) return py::none();
               py::dict result;
               result["count"] = fit->count;
               result["rmse"] = fit->rmse;
               result["rmse_gsd"] = fit->rmse_gsd;
               result["mad_gsd"] = fit->mad_gsd;
               result["max_abs_gsd"] = fit->max_abs_gsd;
               return result;
             });
}

}  // namespace malus::python
