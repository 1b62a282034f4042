#pragma once

// Private to the station room: the files and notes in which each step's result rests in a workspace.

#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "malus/assess/quality.h"
#include "malus/capture/polarized_stack.h"
#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/core/pose.h"
#include "malus/fusion/fused_surface.h"
#include "malus/fusion/refine.h"
#include "malus/height/height_map.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/polarizer_calibration.h"
#include "malus/polarization/reflection.h"
#include "malus/prior/depth_prior.h"
#include "malus/station/step_outputs_internal.h"

namespace malus {

using Json = nlohmann::ordered_json;

/// The polarization step's result: what the images say, before any surface is known.
struct PolarizationStep {
  PolarizationState state;
  Image<float> color;
  Image<float> scene;  ///< unpolarized intensity beyond the object too; empty unless the station is to be found by it
  Pinhole camera;
  std::vector<double> registration_rms_px;
  PolarizerFit polarizer;         ///< angles and exposures that the Stokes vectors were computed with
  bool polarizer_fitted = false;  ///< they come from the images, not from the station
  /// A surface is to come, by which the polarizer's scale is checked: until then the maps lie in polarization/measured.
  bool awaits_surface = false;
};

/// The maps with the polarizer's scale as the surface has it, and what is known of the polarizer then.
struct PolarizerStep {
  Image<float> i_un, rho, phi;
  std::vector<double> angles_rad;
  PolarizerCalibration calibration;
};

/// The refinement's surface, and what it found out as JSON for quality.json.
struct RefinementStep {
  FusedSurface surface;
  Json report = Json::object();
  Image<std::uint8_t> label;       ///< as ReflectionMap::label
  Image<std::uint8_t> confidence;  ///< weight of each pixel's polarization, 0 … 255
};

/// The figures, and the JSON they stand in: quality.json also has the station's name and the refinement's report.
struct AssessStep {
  Quality quality;
  Json file;
};

/// The files of a step: what writes them is collected first, so that they can be written beside each other.
class StepFiles {
 public:
  /// `write(work)` writes the named files, of about so many bytes, below the workspace folder. What it refers to must
  /// live until then.
  void add(const std::vector<std::string>& names, std::size_t bytes,
           std::function<void(const std::filesystem::path& work)> write);
  /// Writes them all, on the context's threads, the largest first, and makes their folders.
  void write(StepOutputs& outputs, const Context& context);

 private:
  struct Task {
    std::vector<std::string> names;
    std::size_t bytes;
    std::function<void(const std::filesystem::path& work)> write;
  };
  std::vector<Task> tasks_;
};

// For each result: `save` adds its rasters to the files of the step and returns the numbers that go into the manifest;
// `load` reads both back. What is loaded equals what was saved to the bit.

Json save(const PolarizationStep& result, StepFiles& files);
Json save(const PolarizerStep& result, StepFiles& files);
Json save(const DepthPrior& result, StepFiles& files);
Json save(const ReflectionMap& result, StepFiles& files);
Json save(const HeightMap& result, StepFiles& files);
Json save(const FusedSurface& result, StepFiles& files);
Json save(const RefinementStep& result, StepFiles& files);
Json save(const AssessStep& result, StepFiles& files);

void load(PolarizationStep& result, const std::filesystem::path& work, const Json& notes);
void load(PolarizerStep& result, const std::filesystem::path& work, const Json& notes);
void load(DepthPrior& result, const std::filesystem::path& work, const Json& notes);
void load(ReflectionMap& result, const std::filesystem::path& work, const Json& notes);
void load(HeightMap& result, const std::filesystem::path& work, const Json& notes);
void load(FusedSurface& result, const std::filesystem::path& work, const Json& notes);
void load(RefinementStep& result, const std::filesystem::path& work, const Json& notes);
void load(AssessStep& result, const std::filesystem::path& work, const Json& notes);

Json to_json(const Pinhole& camera);
Json to_json(const Pose& pose);

}  // namespace malus
