#include <pybind11/eigen.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <algorithm>
#include <tuple>
#include <utility>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "clouds.h"
#include "interruptible.h"
#include "malus/fusion/refinement_verdict_internal.h"
#include "malus/io/curve_pixels_internal.h"
#include "malus/io/given_station_internal.h"
#include "malus/io/station_file_internal.h"
#include "malus/io/workspace_internal.h"
#include "malus/station/check.h"
#include "malus/station/check_picture_internal.h"
#include "malus/station/json_fields_internal.h"
#include "malus/station/overtaken_exports_internal.h"
#include "malus/station/presets_internal.h"
#include "malus/station/reconstruct.h"
#include "malus/station/step_watch_internal.h"
#include "malus/station/surface_words_internal.h"
#include "words.h"

namespace malus::python {
namespace {

/// A station from arrays; the Python side has checked their shapes. `tables`: JSON, see read_given_station.
/// `prior_triangles`: of a mesh, whose vertices are `prior_points`.
Station station_from_arrays(std::vector<Image<float>>& images, bool whole_numbers,
                            const std::optional<CameraValues>& camera, const std::string& tables,
                            const std::optional<Array<double>>& prior_points,
                            const std::optional<Array<float>>& prior_normals,
                            const std::optional<Array<std::uint8_t>>& prior_colors,
                            const std::optional<Array<std::uint32_t>>& prior_triangles,
                            const std::optional<Image<float>>& prior_depth, const std::optional<Mask>& mask,
                            const std::optional<Mask>& labels) {
  Station station;
  GivenInMemory given{images.size(), images.front().size(), {}, prior_points || prior_depth, labels.has_value()};
  if (camera) {
    const auto [lens, pose] = to_camera(*camera, "camera");
    given.camera = CameraSpec{lens, pose};
  }
  station.file = read_given_station(tables, given);
  if (station.file.prior) std::visit([&](const auto& file) { station.prior = file; }, *station.file.prior);
  station.images = std::move(images);
  station.whole_numbers = whole_numbers;
  if (prior_triangles) {
    station.prior = to_mesh(to_cloud(*prior_points), *prior_triangles);
  } else if (prior_points) {
    station.prior = to_cloud(*prior_points, prior_normals, prior_colors);
  } else if (prior_depth) {
    station.prior = *prior_depth;
  }
  station.mask = mask;
  if (labels) {
    station.file.optics.reflection = ReflectionChoice::labels;
    station.labels = labels;
  }
  return station;
}

/// The station with the camera and, after the sweep, the prior from its photos, with the photogrammetry's figures for
/// the report. swept: the rasters of a SweptDepth by name, without those that are empty. files: Photogrammetry::files.
Station with_photogrammetry(Station station, const CameraValues& camera,
                            std::optional<std::map<std::string, Image<float>>>& swept, const std::string& figures,
                            const std::string& times, const std::vector<std::string>& warnings,
                            const std::map<std::filesystem::path, std::string>& files) {
  const auto [lens, pose] = to_camera(camera, "camera");
  station.file.camera = CameraSpec{lens, pose};
  if (swept) {
    const auto take = [&](const char* name) { return std::move((*swept)[name]); };
    station.prior = SweptDepth{take("depth"), take("sigma"), take("shape"), take("hull"), take("hull_sigma")};
  }
  station.photogrammetry = Photogrammetry{figures, times, warnings, files};
  return station;
}

/// The station with other pixels for the curves of intensity against polarizer angle.
Station with_curves_of(Station station, const std::vector<std::array<double, 2>>& pixels) {
  station.file = with_curve_pixels(std::move(station.file), pixels);
  return station;
}

/// The station with a cloud as prior in place of the prior's file.
Station with_cloud(Station station, const Array<double>& points, const std::optional<Array<float>>& normals,
                   const std::optional<Array<std::uint8_t>>& colors) {
  station.prior = to_cloud(points, normals, colors);
  return station;
}

/// The station with developed images (floating point, black 0 and white 1) in place of its RAW files. The noise figures
/// of the RAW files (electrons) are used only if the station states none.
Station with_developed(Station station, const std::vector<std::string>& images, std::optional<double> full_well_e,
                       std::optional<double> read_noise_e) {
  PolarizedSpec& spec = station.file.polarized;
  // Result.save develops them a second time, for a station that has images developed by the run.
  if (station.developed_from.empty()) station.developed_from = std::move(spec.images);
  spec.images.assign(images.begin(), images.end());
  if (!spec.full_well_e && !spec.read_noise_e) {
    spec.full_well_e = full_well_e;
    spec.read_noise_e = read_noise_e;
  }
  return station;
}

/// Name of the check, message and suggestion.
using FileFindings = std::vector<std::tuple<std::string, std::string, std::string>>;

/// The station with warnings and notes about its files, in place of those that it had.
Station with_file_doubts(Station station, const FileFindings& doubts, const FileFindings& notes) {
  station.file_findings.clear();
  for (const auto& [check, message, suggestion] : doubts)
    station.file_findings.push_back({named<Check>(check, "check"), Severity::warning, message, suggestion, {}});
  for (const auto& [check, message, suggestion] : notes)
    station.file_findings.push_back({named<Check>(check, "check"), Severity::note, message, suggestion, {}});
  return station;
}

/// A raster of a result as an array, which keeps the result alive; None without the result.
template <class T, class Map>
py::object map_of(const std::shared_ptr<const T>& of, Map T::*map) {
  return of ? to_array(std::shared_ptr<const Map>(of, &((*of).*map))) : py::none();
}

/// Results of a run under the names of malus.Result, None for those that were not computed. `results` can be passed to
/// another run. `station`: of the run.
py::dict to_dict(const std::shared_ptr<Results>& run, const Station& station) {
  const auto surface = run->get<FusedSurface>();
  const auto prior = run->get<DepthPrior>();
  const auto measured = run->get<MeasuredPolarization>();
  const auto calibrated = run->get<CalibratedPolarization>();
  const auto state = calibrated ? calibrated->state : measured ? measured->state : nullptr;
  const auto report = run->get<QualityReport>();
  const auto view = run->get<StationView>();
  // That of a station whose surface will be in the frame of its photos is not known before they have been placed.
  const bool is_placed = station.has_prior() || !station.file.photos || station.photogrammetry;
  const bool has_pose = station.file.camera && is_placed;
  py::dict result;
  result["depth"] = map_of(surface, &FusedSurface::depth);
  result["normals"] = map_of(surface, &FusedSurface::normals);
  result["sigma"] = map_of(surface, &FusedSurface::sigma);
  result["prior_depth"] = map_of(prior, &DepthPrior::depth);
  result["prior_sigma"] = map_of(prior, &DepthPrior::sigma);
  result["polarization_height"] = map_of(run->get<HeightMap>(), &HeightMap::height);
  result["zenith_rad"] = map_of(run->get<ReflectionMap>(), &ReflectionMap::zenith);
  result["scene"] = map_of(run->get<Scene>(), &Scene::image);
  result["unpolarized"] = map_of(state, &PolarizationState::i_un);
  result["degree"] = map_of(state, &PolarizationState::rho);
  result["phase_rad"] = map_of(state, &PolarizationState::phi);
  result["valid"] = map_of(state, &PolarizationState::valid);
  result["camera"] = surface            ? py::cast(RasterView{surface->camera, surface->pose})
                     : prior            ? py::cast(RasterView{prior->camera, prior->pose})
                     : view && has_pose ? py::cast(RasterView{view->camera, station.file.camera->pose})
                                        : py::none();
  result["status"] = surface  ? py::cast(enum_name(surface->status))
                     : report ? py::cast(enum_name(report->status))
                              : py::none();
  const Confidence* const confidence = report ? &report->confidence : surface ? &surface->confidence : nullptr;
  result["confidence"] =
      confidence ? py::make_tuple(enum_name(confidence->level), confidence->reasons) : py::object(py::none());
  result["warnings"] = run->warnings;
  result["quality"] = report ? py::object(py::str(report->json)) : py::none();
  result["results"] = run;
  return result;
}

void bind_options(py::module_& module) {
  module.def("option_schema", &option_schema_json);
  module.def("default_options", [] { return Options(); });
  module.def("preset_options", &preset_options);
  module.def("presets", [] {
    py::list all;
    for (const Preset& preset : presets())
      all.append(py::make_tuple(std::string(preset.name), std::string(preset.meaning)));
    return all;
  });
  module.def("check_options", [](const Options& options) { return options; });
  module.def("set_option", [](Options& options, const std::string& assignment) {
    set_option(options, assignment);
    return options;
  });
  module.def("options_from_file", &options_from_file);
}

void bind_run(py::module_& module) {
  module.def("step_names", &step_names);
  module.def("describe_run", [](const Options& options, const std::optional<std::string>& until) {
    py::list steps;
    for (const StepDescription& step : describe_run(options, until))
      steps.append(py::make_tuple(step.name, step.does, step.leaves, step.may_leave));
    return steps;
  });

  py::class_<Station>(module, "Station")
      .def_static("load", &Station::load, py::arg("path"), py::arg("photos_of"), WithoutGil())
      .def_static("from_arrays", &station_from_arrays, py::kw_only(), py::arg("images"), py::arg("whole_numbers"),
                  py::arg("camera"), py::arg("tables"), py::arg("prior_points"), py::arg("prior_normals"),
                  py::arg("prior_colors"), py::arg("prior_triangles"), py::arg("prior_depth"), py::arg("mask"),
                  py::arg("labels"))
      .def("describe", &describe_station_json)
      .def("with_developed", &with_developed, py::arg("images"), py::arg("full_well_e"), py::arg("read_noise_e"))
      .def("with_file_doubts", &with_file_doubts, py::arg("doubts"), py::arg("notes"))
      .def("with_curves_of", &with_curves_of, py::arg("pixels"))
      .def("with_cloud", &with_cloud, py::arg("points"), py::arg("normals"), py::arg("colors"))
      .def("with_photogrammetry", &with_photogrammetry, py::arg("camera"), py::arg("swept"), py::arg("figures"),
           py::arg("times"), py::arg("warnings"), py::arg("files"));
  py::class_<Results, std::shared_ptr<Results>>(module, "Results");
  module.def("photos_tables", [](const std::string& path) {
    const StationFile file = read_photos_tables(path);
    Json json = {{"path", path}, {"scale", fields_to_json(file.scale_bars)}, {"control", fields_to_json(file.control)}};
    if (file.photos) json["photos"] = fields_to_json(*file.photos);
    return json.dump();
  });

  module.def(
      "reconstruct",
      [](const Station& station, const Options& options, int threads,
         const std::optional<std::filesystem::path>& workspace, bool replace, const std::optional<std::string>& until,
         const std::optional<std::filesystem::path>& reference, bool keep_maps, const std::shared_ptr<Results>& known,
         const py::object& on_progress, const py::object& on_log) {
        const RunOptions run{.workspace = workspace,
                             .replace = replace,
                             .until = until,
                             .reference = reference,
                             .keep_maps = keep_maps,
                             .known = known.get()};
        auto results = std::make_shared<Results>();
        run_interruptible(threads, on_progress, on_log,
                          [&](const Context& context) { *results = reconstruct(station, options, run, context); });
        return to_dict(results, station);
      },
      py::arg("station"), py::arg("options"), py::arg("threads"), py::arg("workspace") = py::none(),
      py::arg("replace") = false, py::arg("until") = py::none(), py::arg("reference") = py::none(),
      py::arg("keep_maps") = true, py::arg("known") = py::none(), py::arg("progress") = py::none(),
      py::arg("log") = py::none());
}

void bind_workspace(py::module_& module) {
  module.def("claim_workspace", &claim_workspace);
  module.def("surface_confidence", [](const std::string& folder) -> py::object {
    const auto found = surface_confidence(folder);
    if (!found) return py::none();
    const Confidence& confidence = found->confidence;
    return py::make_tuple(enum_name(confidence.level), confidence.reasons, found->assessed);
  });
  module.def("overtaken_exports", &overtaken_exports);
  module.def("read_manifest", [](const std::string& folder) { return Workspace::read_manifest(folder).dump(); });
  module.def("refined_share", [](const std::string& quality) { return refined_share(Json::parse(quality)); });
  module.def("surface_words", [](const std::string& quality) { return surface_words(Json::parse(quality)).dump(); });
  module.def("surface_extras", [](const std::string& quality, const std::string& versions) {
    return surface_extras(Json::parse(quality), Json::parse(versions)).dump();
  });
  module.attr("refined_nowhere") = refined_nowhere;
  module.attr("refined_everywhere") = refined_everywhere;
  module.def("forget_step", &forget_step);
  py::class_<StepWatch>(module, "StepWatch").def(py::init<>()).def("stop", [](StepWatch& watch) {
    return watch.stop().dump();
  });
  module.def("record_step", [](const std::string& folder, const std::string& step,
                               const std::vector<std::string>& files, const std::string& times) {
    record_step(folder, {step, files, times}, {});
  });
}

void bind_check(py::module_& module) {
  module.def("expected_times",
             [](const Station& station, const Options& options, const std::optional<std::string>& until,
                const std::optional<std::pair<int, int>>& width_height, int threads) {
               std::optional<Size> size;
               if (width_height) size = Size{width_height->first, width_height->second};
               // It reads the mask, and of the images the size.
               const std::vector<ExpectedTime> found = computed(threads, [&](const Context& context) {
                 return expected_times(station, options, {until, size}, context);
               });
               py::list times;
               for (const ExpectedTime& time : found) times.append(py::make_tuple(time.step, time.seconds));
               return times;
             });

  module.def("check", [](const Station& station, const Options& options, int threads) {
    return computed(threads,
                    [&](const Context& context) { return plan_to_json(check_station(station, options, context)); });
  });
  module.def("check_picture", [](const Station& station, int threads) {
    CheckPicture picture = computed(threads, [&](const Context& context) { return check_picture(station, context); });
    return std::tuple(std::move(picture.image), std::move(picture.object), to_array<float>(picture.points));
  });
}

}  // namespace

void bind_station(py::module_& module) {
  bind_options(module);
  bind_run(module);
  bind_workspace(module);
  bind_check(module);
}

}  // namespace malus::python
