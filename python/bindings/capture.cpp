#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "interruptible.h"
#include "malus/capture/mosaic_internal.h"
#include "malus/capture/registration_internal.h"
#include "malus/capture/resampling_internal.h"
#include "malus/capture/response_internal.h"
#include "malus/capture/select_object_internal.h"
#include "words.h"

namespace malus::python {
namespace {

py::object register_arrays(const std::vector<Image<float>>& images, const Options& options, int frames_averaged,
                           double full_well_e, double read_noise_e, int threads) {
  const NoiseModel noise{full_well_e, read_noise_e, 0, frames_averaged};
  return by_fields(computed(threads, [&](const Context& context) {
    return register_images(images, noise, options.capture.registration, context);
  }));
}

}  // namespace

void bind_capture(py::module_& module) {
  module.def("linearize", [](Image<float>& image, const std::string& response, double black, double white) {
    RawImage raw{std::move(image), 32};
    PolarizedSpec spec;
    spec.black_level = black;
    spec.white_level = white;
    const ResponseCurve curve = response_curve(stated_response(response), "response");
    const Levels levels = levels_of(raw, spec, curve, 1, "image");
    return computed(1, [&](const Context& context) {
      return raw.pixels.channels() == 3
                 ? linearize_color(raw, curve, levels, "image", context)
                 : linearize(std::move(raw), curve, levels, channel_weights(spec), "image", context).intensity;
    });
  });
  module.def("undistort", [](Image<float>& image, const CameraValues& values, int threads) {
    const LensCamera lens = to_camera(values, "camera").first;
    require_size(image, lens.size, "image");
    return computed(threads, [&](const Context& context) { return undistorted(std::move(image), lens, context); });
  });

  module.def("demosaic", [](const Image<float>& mosaic, int threads) {
    return computed(threads, [&](const Context& context) { return demosaic(mosaic, "mosaic", context).channels; });
  });

  module.def("demosaic_color", [](const Image<float>& mosaic, const std::string& colors, int threads) {
    const auto pattern = named<BayerPattern>(colors, "colors");
    ColorMosaic split =
        computed(threads, [&](const Context& context) { return demosaic_color(mosaic, pattern, "mosaic", context); });
    return std::pair(std::move(split.gray.channels), std::move(split.ratios));
  });

  module.def("register_images", &register_arrays);

  module.def("select_similar", &select_similar, WithoutGil());

  module.def("cut_out_object", [](const Image<std::uint8_t>& picture, const Mask& hints, int iterations, int threads) {
    return computed(threads,
                    [&](const Context& context) { return cut_out_object(picture, hints, iterations, context); });
  });
}

}  // namespace malus::python
