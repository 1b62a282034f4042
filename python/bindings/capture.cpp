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
#include "malus/station/options.h"

namespace malus::python {
namespace {

py::list register_arrays(const std::vector<Array<float>>& arrays, const std::string& options_json, int frames_averaged,
                         double full_well_e, double read_noise_e, int threads) {
  const Options options = options_from_json({}, options_json);
  const NoiseModel noise{full_well_e, read_noise_e, 0, frames_averaged};
  std::vector<Image<float>> images;
  for (const auto& array : arrays) images.push_back(to_image(array));
  std::vector<ImageRegistration> found;
  run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
    found = register_images(images, noise, options.capture.registration, context);
  });
  py::list result;
  for (const ImageRegistration& image : found) {
    py::dict entry;
    entry["status"] = std::string(enum_name(image.status));
    entry["message"] = image.message;
    entry["image_from_base"] = Eigen::MatrixXd(image.image_from_base);
    entry["displacement_px"] = image.displacement_px;
    entry["rms_px"] = image.rms_px;
    result.append(entry);
  }
  return result;
}

}  // namespace

void bind_capture(py::module_& module) {
  module.def("linearize", [](const Array<float>& image, const std::string& response, double black, double white) {
    RawImage raw{to_image(image), 32, true, white};
    PolarizedSpec spec;
    spec.black_level = black;
    spec.white_level = white;
    const Levels levels = levels_of(raw, spec, 1, "image");
    return to_array(raw.pixels.channels() == 3 ? linearize_color(raw, response_curve(response, "response"), levels, {})
                                               : linearize(std::move(raw), response_curve(response, "response"), levels,
                                                           channel_weights(spec), "image", {})
                                                     .intensity);
  });
  module.def("undistort", [](const Array<float>& array, const CameraValues& values, int threads) {
    const LensCamera lens = to_camera(values, "camera").first;
    const Image<float> image = to_image(array);
    require_size(image, lens.size, "image");
    Resampled flat;
    run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
      flat = resample(image, lens.size, ResamplingMap(lens, identity_affine()), Interpolation::bicubic, context);
    });
    return to_array(std::move(flat.image));
  });

  module.def("demosaic", [](const Array<float>& mosaic, int threads) {
    const Image<float> image = to_image(mosaic);
    std::array<Image<float>, 4> channels;
    run_interruptible(threads, py::none(), py::none(),
                      [&](const Context& context) { channels = demosaic(image, "mosaic", context).channels; });
    py::list result;
    for (Image<float>& channel : channels) result.append(to_array(std::move(channel)));
    return result;
  });

  module.def("demosaic_color", [](const Array<float>& mosaic, const std::string& colors, int threads) {
    const Image<float> image = to_image(mosaic);
    ColorMosaic split;
    run_interruptible(threads, py::none(), py::none(),
                      [&](const Context& context) { split = demosaic_color(image, colors, "mosaic", context); });
    py::list channels, ratios;
    for (Image<float>& channel : split.grey.channels) channels.append(to_array(std::move(channel)));
    for (Image<float>& ratio : split.ratios) ratios.append(to_array(std::move(ratio)));
    return py::make_tuple(channels, ratios);
  });

  module.def("register_images", &register_arrays);

  module.def("select_similar", [](const Array<std::uint8_t>& picture, int u, int v, int tolerance) {
    return to_array(select_similar(to_image(picture), u, v, tolerance));
  });

  module.def("cut_out_object",
             [](const Array<std::uint8_t>& picture, const Array<std::uint8_t>& hints, int iterations, int threads) {
               const Image<std::uint8_t> image = to_image(picture);
               const Mask known = to_image(hints);
               Mask object;
               run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
                 object = cut_out_object(image, known, iterations, context);
               });
               return to_array(std::move(object));
             });
}

}  // namespace malus::python
