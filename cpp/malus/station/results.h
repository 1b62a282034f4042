#pragma once

#include <map>
#include <memory>
#include <string>
#include <typeindex>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/confidence.h"
#include "malus/core/field_list.h"
#include "malus/core/finding.h"
#include "malus/core/image.h"
#include "malus/fusion/fused_surface.h"
#include "malus/height/height_map.h"
#include "malus/polarization/pixel_curves.h"
#include "malus/polarization/polarization_state.h"
#include "malus/polarization/polarizer_calibration.h"
#include "malus/polarization/reflection.h"
#include "malus/prior/depth_prior.h"

namespace malus {

// Results of the steps, beside those of other rooms (DepthPrior, ReflectionMap, HeightMap, FusedSurface). A result does
// not change once it is made.

/// What follows from the images alone, before any surface is known.
struct MeasuredPolarization {
  std::shared_ptr<const PolarizationState> state;
  PolarizerFit polarizer;            ///< angles and exposures that the Stokes vectors were computed with
  bool polarizer_fitted = false;     ///< fitted to the images, not taken from the station
  std::vector<PixelCurve> curves{};  ///< of a few pixels, for the report (Fig. 1c)
};

/// The camera of all rasters.
struct StationView {
  Pinhole camera;
  std::vector<double> registration_rms_px;  ///< PolarizedStack::registration_rms_px

  MALUS_FIELDS(camera, registration_rms_px)
};

/// Findings from the images alone: always "response"; "order" where the station gives the angles; others, such as
/// "registration", "misfits" and "texture", only if they give cause for caution; "misfits" also as a note where three
/// angles cannot show any.
struct ImageFindings {
  std::vector<Finding> findings;
};

/// Mean linear color of the images, empty for monochrome ones.
struct ObjectColor {
  Image<float> image;
};

/// Unpolarized intensity of everything in view, object or not; empty if there is nothing but the object.
struct Scene {
  Image<float> image;
};

/// The polarization with the polarizer's scale corrected by means of the surface.
struct CalibratedPolarization {
  std::shared_ptr<const PolarizationState> state;  ///< MeasuredPolarization's own if the surface corrects nothing
  PolarizerCalibration polarizer;
};

/// Where the points of the cloud are seen: 255 = on the prior's surface, 128 = behind or in front of it; empty if the
/// prior is not made of points.
struct PriorPoints {
  Mask map;
};

/// Where the degree of polarization exceeds what the pixel's kind of reflection can give, so that its zenith is set to
/// the largest possible one.
struct ClampedZeniths {
  Mask map;             ///< 255 = clamped
  double fraction = 0;  ///< of the labeled pixels
};

/// Findings from all inputs together before they are fused, most severe first.
struct InputEvidence {
  std::vector<Finding> findings;

  /// Limits the confidence for each finding that is more than a note: to partial for cautions, to low for warnings and
  /// errors.
  void limit(Confidence& confidence) const;
};

/// What the nonlinear refinement found beside the surface.
struct RefinementFindings {
  std::string report_json;         ///< reflectance, light, convergence and cost, with standard deviations
  Image<std::uint8_t> label;       ///< as ReflectionMap::label
  Image<std::uint8_t> confidence;  ///< weight of each pixel's polarization, 0 … 255
  Image<std::uint8_t> trust;       ///< share of the refined surface in the result, 0 (prior) … 255
  Image<float> mirrored;           ///< unpolarized intensity of the mirrored light, unit of the images; NaN = not known
};

/// Every figure of the assessment, and the reports of refinement and photogrammetry.
struct QualityReport {
  std::string json;                             ///< quality.json
  FusionStatus status = FusionStatus::not_run;  ///< of the fused surface, as in quality.json
  Confidence confidence;                        ///< as in quality.json
  Image<float> distance;  ///< from the reference, station view and unit, NaN = not compared; empty without a reference
};

/// Results by their type, in shared ownership.
class Results {
 public:
  std::vector<std::string> warnings;  ///< of all steps, "<step>: <sentence>"

  /// Null if the result was not made or is already freed.
  template <class T>
  std::shared_ptr<const T> get() const {
    return std::static_pointer_cast<const T>(get(typeid(T), nullptr));
  }

  /// The same for a type known at run time. With a key: null if the result was made under another key.
  std::shared_ptr<const void> get(std::type_index type, const std::string* key) const {
    const auto found = entries_.find(type);
    const bool wanted = found != entries_.end() && (key == nullptr || found->second.key == *key);
    return wanted ? found->second.value : nullptr;
  }
  void set(std::type_index type, std::string key, std::shared_ptr<const void> value) {
    entries_[type] = {std::move(key), std::move(value)};
  }
  template <class Unwanted>
  void drop_if(Unwanted&& is_unwanted) {
    std::erase_if(entries_, [&](const auto& entry) { return is_unwanted(entry.first); });
  }

 private:
  struct Entry {
    std::string key;  ///< of the step
    std::shared_ptr<const void> value;
  };
  std::map<std::type_index, Entry> entries_;
};

}  // namespace malus
