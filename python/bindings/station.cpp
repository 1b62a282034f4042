#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "clouds.h"
#include "interruptible.h"
#include "malus/core/length_unit.h"
#include "malus/station/check.h"
#include "malus/station/describe.h"
#include "malus/station/options.h"
#include "malus/station/reconstruct.h"

namespace malus::python {
namespace {

Station station_from_arrays(const std::vector<Array<float>>& images, const std::vector<double>& angles_deg,
                            const std::string& model, int width, int height, const std::vector<double>& params,
                            const Eigen::Matrix3d& rotation, const Eigen::Vector3d& translation,
                            const std::optional<Array<double>>& prior_points,
                            const std::optional<Array<float>>& prior_depth,
                            const std::optional<Array<std::uint8_t>>& mask, const std::string& name,
                            const std::string& unit, std::optional<double> refractive_index,
                            const std::string& reflection, int frames_averaged, std::optional<double> full_well_e,
                            std::optional<double> read_noise_e) {
  Station station;
  station.file.name = name;
  station.file.unit = length_unit(unit).name;
  station.file.polarized.angles_deg = angles_deg;
  station.file.polarized.frames_averaged = frames_averaged;
  station.file.polarized.full_well_e = full_well_e;
  station.file.polarized.read_noise_e = read_noise_e;
  station.file.optics.refractive_index = refractive_index;
  station.file.optics.reflection = reflection;
  CameraSpec camera{{lens_model(model, "model"), {width, height}, params}, {rotation, translation}};
  camera.lens.validate("camera");
  station.file.camera = camera;
  for (const auto& image : images) station.images.push_back(to_image(image));
  if (prior_points) station.cloud = to_cloud(*prior_points);
  if (prior_depth) station.prior_depth = to_image(*prior_depth);
  if (mask) station.mask = to_image(*mask);
  return station;
}

/// The station with the camera and, once it is swept, the prior that its photos gave, and what is to be reported of
/// them.
Station with_photogrammetry(const Station& station, const CameraValues& camera,
                            const std::optional<Array<float>>& depth, const std::optional<Array<float>>& sigma,
                            const std::optional<Array<float>>& shape, const std::string& figures) {
  Station result = station;
  const auto [lens, pose] = to_camera(camera, "camera");
  result.file.camera = CameraSpec{lens, pose};
  if (depth && sigma) {
    result.swept = SweptDepth{to_image(*depth), to_image(*sigma), shape ? to_image(*shape) : Image<float>()};
  }
  result.photogrammetry_json = figures;
  return result;
}

/// The station with a cloud in place of the file that it names.
Station with_cloud(const Station& station, const Array<double>& points, const std::optional<Array<float>>& normals) {
  Station result = station;
  result.cloud = to_cloud(points);
  if (!normals) return result;
  for (py::ssize_t i = 0; i < normals->shape(0); ++i)
    result.cloud->normals.emplace_back(normals->at(i, 0), normals->at(i, 1), normals->at(i, 2));
  return result;
}

/// The station with developed images (floating point, black 0 and white 1) in place of its RAW files. Noise in
/// electrons where the files say it and the station does not.
Station with_developed(const Station& station, const std::vector<std::string>& images,
                       std::optional<double> full_well_e, std::optional<double> read_noise_e) {
  Station result = station;
  PolarizedSpec& spec = result.file.polarized;
  spec.images.assign(images.begin(), images.end());
  if (!spec.full_well_e && !spec.read_noise_e) {
    spec.full_well_e = full_well_e;
    spec.read_noise_e = read_noise_e;
  }
  return result;
}

py::dict to_dict(Reconstruction&& run) {
  py::dict result;
  const auto raster = [&](const char* name, Image<float>&& image) { result[name] = to_array(std::move(image)); };
  FusedSurface surface = std::move(run.surface).value_or(FusedSurface{});
  raster("depth", std::move(surface.depth));
  raster("normals", std::move(surface.normals));
  raster("sigma", std::move(surface.sigma));
  DepthPrior prior = std::move(run.prior).value_or(DepthPrior{});
  raster("prior_depth", std::move(prior.depth));
  raster("prior_sigma", std::move(prior.sigma));
  raster("polarization_height", std::move(run.height).value_or(HeightMap{}).height);
  raster("unpolarized", std::move(run.polarization.i_un));
  raster("scene", std::move(run.scene));
  result["valid"] = to_array(std::move(run.polarization.valid));
  raster("degree", std::move(run.polarization.rho));
  raster("phase_rad", std::move(run.polarization.phi));
  raster("zenith_rad", std::move(run.reflection).value_or(ReflectionMap{}).zenith);
  result["quality"] = run.quality ? py::object(py::str(run.quality_json)) : py::none();
  return result;
}

}  // namespace

void bind_station(py::module_& module) {
  module.def("option_schema", &option_schema_json);
  module.def("default_options", [] { return options_to_json({}); });
  module.def("check_options", [](const std::string& json) { return options_to_json(options_from_json({}, json)); });
  module.def("set_option", [](const std::string& json, const std::string& assignment) {
    Options options = options_from_json({}, json);
    set_option(options, assignment);
    return options_to_json(options);
  });
  module.def("options_from_file", [](const std::string& json, const std::string& path) {
    return options_to_json(options_from_file(options_from_json({}, json), path));
  });
  module.def("step_names", [] { return std::vector<std::string>(step_names.begin(), step_names.end()); });

  py::class_<Station>(module, "Station")
      .def_static("load", [](const std::string& path) { return Station::load(path); })
      .def_static("from_arrays", &station_from_arrays, py::kw_only(), py::arg("images"), py::arg("angles_deg"),
                  py::arg("model"), py::arg("width"), py::arg("height"), py::arg("params"), py::arg("rotation"),
                  py::arg("translation"), py::arg("prior_points"), py::arg("prior_depth"), py::arg("mask"),
                  py::arg("name"), py::arg("unit"), py::arg("refractive_index"), py::arg("reflection"),
                  py::arg("frames_averaged"), py::arg("full_well_e"), py::arg("read_noise_e"))
      .def("describe", &describe_station_json)
      .def("with_developed", &with_developed, py::arg("images"), py::arg("full_well_e"), py::arg("read_noise_e"))
      .def("with_cloud", &with_cloud, py::arg("points"), py::arg("normals"))
      .def("with_photogrammetry", &with_photogrammetry, py::arg("camera"), py::arg("prior_depth"),
           py::arg("prior_sigma"), py::arg("prior_shape"), py::arg("figures"));

  module.def(
      "reconstruct",
      [](const Station& station, const std::string& options_json, const std::optional<std::string>& workspace,
         const std::optional<std::string>& until, const std::optional<std::string>& reference, bool keep_maps,
         int threads, const py::object& on_progress, const py::object& on_log) {
        const Options options = options_from_json({}, options_json);
        RunOptions run;
        if (workspace) run.workspace = *workspace;
        run.until = until;
        if (reference) run.reference = *reference;
        run.keep_maps = keep_maps;
        Reconstruction result;
        run_interruptible(threads, on_progress, on_log,
                          [&](const Context& context) { result = reconstruct(station, options, run, context); });
        return to_dict(std::move(result));
      },
      py::arg("station"), py::arg("options"), py::arg("workspace"), py::arg("until"), py::arg("reference"),
      py::arg("keep_maps"), py::arg("threads"), py::arg("progress"), py::arg("log"));

  module.def("check", [](const Station& station, const std::string& options_json, int threads) {
    std::string plan;
    run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
      plan = plan_to_json(check_station(station, options_from_json({}, options_json), context));
    });
    return plan;
  });
}

}  // namespace malus::python
