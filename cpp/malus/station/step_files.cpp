#include <algorithm>
#include <cmath>
#include <functional>
#include <mutex>
#include <utility>

#include "malus/core/parallel.h"
#include "malus/io/atomic_file.h"
#include "malus/io/colmap_model.h"
#include "malus/io/image_file.h"
#include "malus/io/input_file.h"
#include "malus/station/json_fields_internal.h"
#include "malus/station/step_files_internal.h"

namespace malus {
namespace {

namespace fs = std::filesystem;

void save_raster(const Image<float>& raster, const std::string& name, StepFiles& files) {
  files.add({name}, raster.count() * sizeof(float),
            [&raster, name](const fs::path& work) { write_float_tiff(work / name, raster); });
}

void save_bytes(const Image<std::uint8_t>& raster, const std::string& name, StepFiles& files) {
  files.add({name}, raster.count(), [&raster, name](const fs::path& work) { write_png(work / name, raster); });
}

/// Folder of the maps of intensity, degree and phase, see PolarizationStep::awaits_surface.
std::string maps_folder(bool awaits_surface) {
  return awaits_surface ? "polarization/measured/" : "polarization/";
}

Json to_json(const PolarizerFit& fit) {
  return {{"angles_rad", fit.angles_rad},
          {"gains", fit.gains},
          {"image_information", std::vector<double>(fit.image_information.data(),
                                                    fit.image_information.data() + fit.image_information.size())},
          {"nominal_weight",
           std::vector<double>(fit.nominal_weight.data(), fit.nominal_weight.data() + fit.nominal_weight.size())},
          {"residual_before", fit.residual_before},
          {"residual_after", fit.residual_after},
          {"pixels", fit.pixels}};
}

PolarizerFit polarizer_fit_from_json(const Json& json) {
  PolarizerFit fit;
  fit.angles_rad = json.at("angles_rad").get<std::vector<double>>();
  fit.gains = json.at("gains").get<std::vector<double>>();
  const auto weight = json.at("nominal_weight").get<std::vector<double>>();
  const auto information = json.at("image_information").get<std::vector<double>>();
  const auto size = static_cast<Eigen::Index>(weight.size());
  fit.nominal_weight = Eigen::Map<const Eigen::VectorXd>(weight.data(), size);
  fit.image_information = Eigen::Map<const Eigen::MatrixXd>(information.data(), size, size);
  fit.residual_before = json.at("residual_before").get<double>();
  fit.residual_after = json.at("residual_after").get<double>();
  fit.pixels = json.at("pixels").get<double>();
  return fit;
}

/// JSON has no infinity or NaN; both come back as NaN.
double number(const Json& json) {
  return json.is_number() ? json.get<double>() : std::nan("");
}

Pinhole pinhole_from_json(const Json& json) {
  return {{json.at("width").get<int>(), json.at("height").get<int>()},
          json.at("fx").get<double>(),
          json.at("fy").get<double>(),
          json.at("cx").get<double>(),
          json.at("cy").get<double>()};
}

Pose pose_from_json(const Json& json) {
  Pose pose;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) pose.rotation(i, j) = json.at("rotation").at(i).at(j).get<double>();
    pose.translation[i] = json.at("translation").at(i).get<double>();
  }
  return pose;
}

}  // namespace

void StepFiles::add(const std::vector<std::string>& names, std::size_t bytes,
                    std::function<void(const fs::path& work)> write) {
  tasks_.push_back({names, bytes, std::move(write)});
}

void StepFiles::write(StepOutputs& outputs, const Context& context) {
  for (const Task& task : tasks_) {
    for (const std::string& name : task.names) create_folder((outputs.folder() / name).parent_path());
  }
  std::ranges::stable_sort(tasks_, std::greater<>(), &Task::bytes);
  // Who finds nothing left to write hashes what is written.
  std::mutex mutex;
  std::size_t next = 0;
  std::vector<std::string> written;
  parallel_for(context, tasks_.size(), 1, [&](std::size_t, std::size_t) {
    std::unique_lock lock(mutex);
    while (next < tasks_.size() || !written.empty()) {
      if (next < tasks_.size()) {
        const Task& task = tasks_[next++];
        lock.unlock();
        task.write(outputs.folder());
        lock.lock();
        written.insert(written.end(), task.names.begin(), task.names.end());
      } else {
        const std::string name = written.back();
        written.pop_back();
        lock.unlock();
        outputs.add(name);
        lock.lock();
      }
    }
  });
}

Json to_json(const Pinhole& camera) {
  return {{"width", camera.size.width},
          {"height", camera.size.height},
          {"fx", camera.fx},
          {"fy", camera.fy},
          {"cx", camera.cx},
          {"cy", camera.cy}};
}

Json to_json(const Pose& pose) {
  Json rotation = Json::array(), translation = Json::array();
  for (int i = 0; i < 3; ++i) {
    rotation.push_back({pose.rotation(i, 0), pose.rotation(i, 1), pose.rotation(i, 2)});
    translation.push_back(pose.translation[i]);
  }
  return {{"rotation", rotation}, {"translation", translation}};
}

Json save(const PolarizationStep& result, StepFiles& files) {
  const PolarizationState& state = result.state;
  const std::string maps = maps_folder(result.awaits_surface);
  // It is compressed, which takes longer than the others: begun last, all would wait for it.
  save_bytes(state.valid, "polarization/valid.png", files);
  save_raster(state.i_un, maps + "unpolarized.tif", files);
  save_raster(state.rho, maps + "degree.tif", files);
  save_raster(state.phi, maps + "phase.tif", files);
  save_raster(state.residual, "polarization/residual.tif", files);
  if (!state.variance_factor.empty()) {
    save_raster(state.variance_factor, "polarization/variance_factor.tif", files);
  }
  if (!result.color.empty()) save_raster(result.color, "polarization/color.tif", files);
  if (!result.scene.empty()) save_raster(result.scene, "polarization/scene.tif", files);
  return {{"camera", to_json(result.camera)},
          {"has_scene", !result.scene.empty()},
          {"angles_rad", state.angles_rad},
          {"exposures", state.exposures},
          {"noise",
           {{"full_well_e", state.noise.full_well_e},
            {"read_noise_e", state.noise.read_noise_e},
            {"quantization", state.noise.quantization},
            {"frames_averaged", state.noise.frames_averaged}}},
          {"registration_rms_px", result.registration_rms_px},
          {"polarizer", to_json(result.polarizer)},
          {"polarizer_fitted", result.polarizer_fitted},
          {"awaits_surface", result.awaits_surface}};
}

void load(PolarizationStep& result, const fs::path& work, const Json& notes) {
  PolarizationState& state = result.state;
  result.polarizer = polarizer_fit_from_json(notes.at("polarizer"));
  result.polarizer_fitted = notes.at("polarizer_fitted").get<bool>();
  result.awaits_surface = notes.at("awaits_surface").get<bool>();
  const fs::path maps = work / maps_folder(result.awaits_surface);
  state.i_un = read_float_raster(maps / "unpolarized.tif");
  state.rho = read_float_raster(maps / "degree.tif");
  state.phi = read_float_raster(maps / "phase.tif");
  state.residual = read_float_raster(work / "polarization/residual.tif");
  state.valid = read_labels(work / "polarization/valid.png");
  if (fs::exists(work / "polarization/variance_factor.tif")) {
    state.variance_factor = read_float_raster(work / "polarization/variance_factor.tif");
  }
  result.camera = pinhole_from_json(notes.at("camera"));
  state.angles_rad = notes.at("angles_rad").get<std::vector<double>>();
  state.exposures = notes.at("exposures").get<std::vector<int>>();
  const Json& noise = notes.at("noise");
  state.noise.full_well_e = noise.at("full_well_e").get<double>();
  state.noise.read_noise_e = noise.at("read_noise_e").get<double>();
  state.noise.quantization = noise.at("quantization").get<double>();
  state.noise.frames_averaged = noise.at("frames_averaged").get<int>();
  result.registration_rms_px.clear();
  for (const Json& rms : notes.at("registration_rms_px")) result.registration_rms_px.push_back(number(rms));
  if (fs::exists(work / "polarization/color.tif")) result.color = read_float_raster(work / "polarization/color.tif");
  if (notes.at("has_scene").get<bool>()) result.scene = read_float_raster(work / "polarization/scene.tif");
}

Json save(const PolarizerStep& result, StepFiles& files) {
  save_raster(result.i_un, "polarization/unpolarized.tif", files);
  save_raster(result.rho, "polarization/degree.tif", files);
  save_raster(result.phi, "polarization/phase.tif", files);
  return {{"angles_rad", result.angles_rad}, {"calibration", fields_to_json(result.calibration)}};
}

void load(PolarizerStep& result, const fs::path& work, const Json& notes) {
  result.i_un = read_float_raster(work / "polarization/unpolarized.tif");
  result.rho = read_float_raster(work / "polarization/degree.tif");
  result.phi = read_float_raster(work / "polarization/phase.tif");
  result.angles_rad = notes.at("angles_rad").get<std::vector<double>>();
  fields_from_json(result.calibration, notes.at("calibration"));
}

Json save(const DepthPrior& result, StepFiles& files) {
  save_raster(result.depth, "prior/depth.tif", files);
  save_raster(result.sigma, "prior/sigma.tif", files);
  return {{"camera", to_json(result.camera)},
          {"pose", to_json(result.pose)},
          {"points_total", result.points_total},
          {"points_used", result.points_used},
          {"noise", result.noise},
          {"spacing_px", result.spacing_px},
          {"smoothing_px", result.smoothing_px},
          {"filled_fraction", result.filled_fraction}};
}

void load(DepthPrior& result, const fs::path& work, const Json& notes) {
  result.depth = read_float_raster(work / "prior/depth.tif");
  result.sigma = read_float_raster(work / "prior/sigma.tif");
  result.camera = pinhole_from_json(notes.at("camera"));
  result.pose = pose_from_json(notes.at("pose"));
  result.points_total = number(notes.at("points_total"));
  result.points_used = number(notes.at("points_used"));
  result.noise = number(notes.at("noise"));
  result.spacing_px = number(notes.at("spacing_px"));
  result.smoothing_px = number(notes.at("smoothing_px"));
  result.filled_fraction = number(notes.at("filled_fraction"));
}

Json save(const ReflectionMap& result, StepFiles& files) {
  save_raster(result.zenith, "polarization/zenith.tif", files);
  save_bytes(result.label, "polarization/label.png", files);
  return Json::object();
}

void load(ReflectionMap& result, const fs::path& work, const Json&) {
  result.zenith = read_float_raster(work / "polarization/zenith.tif");
  result.label = read_labels(work / "polarization/label.png");
}

Json save(const HeightMap& result, StepFiles& files) {
  save_raster(result.height, "height/height.tif", files);
  return {{"perspective", result.perspective},
          {"light", {result.light[0], result.light[1], result.light[2], result.light[3]}},
          {"status", result.status},
          {"residual_rms", result.residual_rms},
          {"unknowns", result.unknowns}};
}

void load(HeightMap& result, const fs::path& work, const Json& notes) {
  result.height = read_float_raster(work / "height/height.tif");
  result.perspective = notes.at("perspective").get<bool>();
  for (int i = 0; i < 4; ++i) result.light[i] = number(notes.at("light").at(i));
  result.status = notes.at("status").get<std::string>();
  result.residual_rms = number(notes.at("residual_rms"));
  result.unknowns = notes.at("unknowns").get<std::size_t>();
}

Json save(const FusedSurface& result, StepFiles& files) {
  save_raster(result.depth, "fused/depth.tif", files);
  save_raster(result.normals, "fused/normals.tif", files);
  save_raster(result.sigma, "fused/sigma.tif", files);
  files.add({"fused/camera.txt", "fused/image.txt"}, 0, [&result](const fs::path& work) {
    write_colmap_text(work / "fused/camera.txt", work / "fused/image.txt", result.camera, result.pose, "depth.tif");
  });
  return {{"camera", to_json(result.camera)},
          {"pose", to_json(result.pose)},
          {"method", result.method},
          {"status", result.status},
          {"warnings", result.warnings}};
}

void load(FusedSurface& result, const fs::path& work, const Json& notes) {
  result.depth = read_float_raster(work / "fused/depth.tif");
  result.normals = read_float_raster(work / "fused/normals.tif");
  result.sigma = read_float_raster(work / "fused/sigma.tif");
  result.camera = pinhole_from_json(notes.at("camera"));
  result.pose = pose_from_json(notes.at("pose"));
  result.method = notes.at("method").get<std::string>();
  result.status = notes.at("status").get<std::string>();
  result.warnings = notes.at("warnings").get<std::vector<std::string>>();
}

Json save(const RefinementStep& result, StepFiles& files) {
  Json notes = save(result.surface, files);
  save_bytes(result.label, "fused/label.png", files);
  save_bytes(result.confidence, "fused/confidence.png", files);
  notes["report"] = result.report;
  return notes;
}

void load(RefinementStep& result, const fs::path& work, const Json& notes) {
  load(result.surface, work, notes);
  result.label = read_labels(work / "fused/label.png");
  result.confidence = read_labels(work / "fused/confidence.png");
  result.report = notes.at("report");
}

Json save(const AssessStep& result, StepFiles& files) {
  if (result.quality.reference && !result.quality.reference->distance.empty()) {
    save_raster(result.quality.reference->distance, "fused/reference_distance.tif", files);
  }
  files.add({"quality.json"}, 0,
            [&result](const fs::path& work) { write_file(work / "quality.json", result.file.dump(2) + "\n"); });
  return Json::object();
}

void load(AssessStep& result, const fs::path& work, const Json&) {
  result.file = Json::parse(read_file(work / "quality.json", "figures"));
  fields_from_json(result.quality, result.file);
  if (result.quality.reference) {
    result.quality.reference->distance = read_float_raster(work / "fused/reference_distance.tif");
  }
}

}  // namespace malus
