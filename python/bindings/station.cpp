#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <algorithm>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "clouds.h"
#include "interruptible.h"
#include "malus/core/length_unit.h"
#include "malus/io/sha256.h"
#include "malus/io/workspace_internal.h"
#include "malus/station/check.h"
#include "malus/station/check_picture.h"
#include "malus/station/describe.h"
#include "malus/station/options.h"
#include "malus/station/reconstruct.h"

namespace malus::python {
namespace {

Station station_from_arrays(const std::vector<Array<float>>& images, const std::vector<double>& angles_deg,
                            const CameraValues& camera, const std::optional<Array<double>>& prior_points,
                            const std::optional<Array<float>>& prior_depth,
                            const std::optional<Array<std::uint8_t>>& mask, const std::string& name,
                            const std::string& unit, std::optional<double> refractive_index,
                            const std::string& reflection, int frames_averaged, std::optional<double> full_well_e,
                            std::optional<double> read_noise_e) {
  Station station;
  StationFile& file = station.file;
  file.name = name;
  file.unit = length_unit(unit).name;
  file.polarized.angles_deg = angles_deg;
  file.polarized.frames_averaged = frames_averaged;
  file.polarized.full_well_e = full_well_e;
  file.polarized.read_noise_e = read_noise_e;
  file.optics.refractive_index = refractive_index;
  const auto choice = enum_value<ReflectionChoice>(reflection);
  if (!choice || *choice == ReflectionChoice::labels)
    throw input_error("reflection = \"" + reflection + "\", expected \"auto\", \"diffuse\" or \"specular\"");
  file.optics.reflection = *choice;
  const auto [lens, pose] = to_camera(camera, "camera");
  file.camera = CameraSpec{lens, pose};
  for (const auto& image : images) station.images.push_back(to_image(image));
  if (prior_points) station.prior = to_cloud(*prior_points);
  if (prior_depth) station.prior = to_image(*prior_depth);
  if (mask) station.mask = to_image(*mask);
  return station;
}

/// The station with the camera and, once it is swept, the prior that its photos gave, and what is to be reported of
/// them.
Station with_photogrammetry(const Station& station, const CameraValues& camera,
                            const std::optional<Array<float>>& depth, const std::optional<Array<float>>& sigma,
                            const std::optional<Array<float>>& shape, const std::string& figures,
                            const std::string& times, const std::vector<std::string>& warnings) {
  Station result = station;
  const auto [lens, pose] = to_camera(camera, "camera");
  result.file.camera = CameraSpec{lens, pose};
  if (depth && sigma) {
    result.prior = SweptDepth{to_image(*depth), to_image(*sigma), shape ? to_image(*shape) : Image<float>()};
  }
  result.photogrammetry = Photogrammetry{figures, times, warnings};
  return result;
}

/// The station with a cloud in place of the file that it names.
Station with_cloud(const Station& station, const Array<double>& points, const std::optional<Array<float>>& normals) {
  Station result = station;
  PointCloud cloud = to_cloud(points);
  if (normals) {
    for (py::ssize_t i = 0; i < normals->shape(0); ++i)
      cloud.normals.emplace_back(normals->at(i, 0), normals->at(i, 1), normals->at(i, 2));
  }
  result.prior = std::move(cloud);
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

/// The station with doubts about its files, as messages and suggestions.
Station with_file_doubts(const Station& station, const std::vector<std::pair<std::string, std::string>>& doubts) {
  Station result = station;
  for (const auto& [message, suggestion] : doubts)
    result.file_findings.push_back({"encoding", Severity::warning, message, suggestion, {}});
  return result;
}

/// The maps of a run by the names of malus.Result, None for what was not made, and `results`, to be given to another
/// run.
py::dict to_dict(const std::shared_ptr<Results>& run) {
  py::dict result;
  const auto maps = [&]<class T, class... Maps>(const std::shared_ptr<const T>& of, const Maps&... named) {
    const auto add = [&](const char* name, const auto map) {
      using Map = std::remove_cvref_t<decltype((*of).*map)>;
      result[name] = of ? to_array(std::shared_ptr<const Map>(of, &((*of).*map))) : py::none();
    };
    (add(named.first, named.second), ...);
  };
  maps(run->get<FusedSurface>(), std::pair("depth", &FusedSurface::depth), std::pair("normals", &FusedSurface::normals),
       std::pair("sigma", &FusedSurface::sigma));
  maps(run->get<DepthPrior>(), std::pair("prior_depth", &DepthPrior::depth),
       std::pair("prior_sigma", &DepthPrior::sigma));
  maps(run->get<HeightMap>(), std::pair("polarization_height", &HeightMap::height));
  maps(run->get<ReflectionMap>(), std::pair("zenith_rad", &ReflectionMap::zenith));
  maps(run->get<Scene>(), std::pair("scene", &Scene::image));
  const auto measured = run->get<MeasuredPolarization>();
  const auto calibrated = run->get<CalibratedPolarization>();
  maps(calibrated ? calibrated->state
       : measured ? measured->state
                  : nullptr,
       std::pair("unpolarized", &PolarizationState::i_un), std::pair("degree", &PolarizationState::rho),
       std::pair("phase_rad", &PolarizationState::phi), std::pair("valid", &PolarizationState::valid));
  const auto report = run->get<QualityReport>();
  result["quality"] = report ? py::object(py::str(report->json)) : py::none();
  result["results"] = run;
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
  module.def("step_names", &step_names);
  module.def("describe_run", [](const std::string& options_json, const std::optional<std::string>& until) {
    py::list steps;
    for (const StepDescription& step : describe_run(options_from_json({}, options_json), until))
      steps.append(py::make_tuple(step.name, step.does, step.leaves));
    return steps;
  });

  py::class_<Station>(module, "Station")
      .def_static("load", [](const std::string& path) { return Station::load(path); })
      .def_static("from_arrays", &station_from_arrays, py::kw_only(), py::arg("images"), py::arg("angles_deg"),
                  py::arg("camera"), py::arg("prior_points"), py::arg("prior_depth"), py::arg("mask"), py::arg("name"),
                  py::arg("unit"), py::arg("refractive_index"), py::arg("reflection"), py::arg("frames_averaged"),
                  py::arg("full_well_e"), py::arg("read_noise_e"))
      .def("describe", &describe_station_json)
      .def("with_developed", &with_developed, py::arg("images"), py::arg("full_well_e"), py::arg("read_noise_e"))
      .def("with_file_doubts", &with_file_doubts, py::arg("doubts"))
      .def("with_cloud", &with_cloud, py::arg("points"), py::arg("normals"))
      .def("with_photogrammetry", &with_photogrammetry, py::arg("camera"), py::arg("prior_depth"),
           py::arg("prior_sigma"), py::arg("prior_shape"), py::arg("figures"), py::arg("times"), py::arg("warnings"));
  py::class_<Results, std::shared_ptr<Results>>(module, "Results");

  module.def(
      "reconstruct",
      [](const Station& station, const std::string& options_json, const std::optional<std::string>& workspace,
         bool replace, const std::optional<std::string>& until, const std::optional<std::string>& reference,
         bool keep_maps, const std::shared_ptr<Results>& known, int threads, const py::object& on_progress,
         const py::object& on_log) {
        const Options options = options_from_json({}, options_json);
        RunOptions run{.replace = replace, .until = until, .keep_maps = keep_maps, .known = known.get()};
        if (workspace) run.workspace = *workspace;
        if (reference) run.reference = *reference;
        auto results = std::make_shared<Results>();
        run_interruptible(threads, on_progress, on_log,
                          [&](const Context& context) { *results = reconstruct(station, options, run, context); });
        return to_dict(results);
      },
      py::arg("station"), py::arg("options"), py::arg("workspace"), py::arg("replace"), py::arg("until"),
      py::arg("reference"), py::arg("keep_maps"), py::arg("known"), py::arg("threads"), py::arg("progress"),
      py::arg("log"));
  module.def("claim_workspace", [](const std::string& folder, const Station& station, bool replace) {
    claim_workspace(folder, station, replace);
  });
  module.def("read_manifest", [](const std::string& folder) { return Workspace::read_manifest(folder).dump(); });
  module.def("sha256_of_file", [](const std::string& path) { return sha256_of_file(path, "output"); });
  module.def("forget_step", [](const std::string& folder, const std::string& step) { forget_step(folder, step); });
  module.def("record_step",
             [](const std::string& folder, const std::string& step, const std::vector<std::string>& files,
                double seconds) { record_step(folder, step, files, seconds, {}); });

  module.def("check", [](const Station& station, const std::string& options_json, int threads) {
    std::string plan;
    run_interruptible(threads, py::none(), py::none(), [&](const Context& context) {
      plan = plan_to_json(check_station(station, options_from_json({}, options_json), context));
    });
    return plan;
  });
  module.def("check_picture", [](const Station& station, int threads) {
    CheckPicture picture;
    run_interruptible(threads, py::none(), py::none(),
                      [&](const Context& context) { picture = check_picture(station, context); });
    py::array_t<float> points({static_cast<py::ssize_t>(picture.points.size()), py::ssize_t{3}});
    std::ranges::copy(picture.points, reinterpret_cast<Eigen::Vector3f*>(points.mutable_data()));
    return py::make_tuple(to_array(std::move(picture.image)), to_array(std::move(picture.object)), points);
  });
}

}  // namespace malus::python
