#include <algorithm>
#include <cmath>
#include <sstream>

#include "malus/core/digits_internal.h"
#include "malus/io/resection_internal.h"
#include "malus/station/control_points_internal.h"

namespace malus {
namespace {

/// RMS distance of the marks that determined the pose, or of those that check it. Points behind the camera have no
/// distance and are left out; NaN if no mark is left.
double rms_px(const std::vector<ControlResidual>& residuals, bool check) {
  double squares = 0, count = 0;
  for (const ControlResidual& residual : residuals) {
    if (residual.check != check || std::isnan(residual.length_px())) continue;
    squares += std::pow(residual.length_px(), 2);
    ++count;
  }
  return std::sqrt(squares / count);
}

/// RMS distance of the marks that determined the pose; if the pose was given, of all marks.
double fit_px(const StationFile& station, const std::vector<ControlResidual>& residuals) {
  return rms_px(residuals, !station.resection);
}

/// RMS distance of the marks that were not used to determine the pose; NaN without such marks.
double held_out_px(const StationFile& station, const std::vector<ControlResidual>& residuals) {
  return station.resection ? rms_px(residuals, true) : NAN;
}

}  // namespace

double ControlResidual::length_px() const {
  return std::hypot(du_px, dv_px);
}

std::vector<ControlResidual> control_residuals(const StationFile& station) {
  std::vector<ControlResidual> residuals;
  if (!station.camera) return residuals;
  for (const ControlPoint& point : station.control) {
    if (!point.pixel) continue;
    const Eigen::Vector2d off = mark_residual(point.marked(), station.camera->lens, station.camera->pose);
    residuals.push_back({point.name, point.check || !station.resection, off.x(), off.y()});
  }
  return residuals;
}

std::vector<std::string> control_warnings(const StationFile& station) {
  constexpr double worth_a_warning_px = 3;
  std::vector<std::string> warnings;
  for (const ControlResidual& residual : control_residuals(station)) {
    const double off = residual.length_px();
    if (off <= worth_a_warning_px) continue;
    const std::string finding =
        std::isnan(off) ? "is marked in the image, but lies behind the camera"
                        : "its mark lies " + with_digits(off, 3) + " px from where the camera sees the point";
    warnings.push_back("[[control]] " + residual.name + ": " + finding);
  }
  if (station.resection && station.resection->doubtful)
    warnings.push_back("[[control]] " + *station.resection->doubtful +
                       ": without this point the others fit far better; are its mark and its coordinates right?");
  return warnings;
}

std::string describe_control(const StationFile& station) {
  const std::vector<ControlResidual> residuals = control_residuals(station);
  if (residuals.empty()) return {};
  std::ostringstream text;
  const auto used = std::ranges::count(residuals, false, &ControlResidual::check);
  if (station.resection) {
    text << "position of the camera from " << used << " control points, center ± "
         << with_digits(station.resection->center_sigma, 3) << " " << station.unit << "; ";
  } else {
    text << residuals.size() << " control points compared with the camera's position; ";
  }
  if (const double rms = fit_px(station, residuals); std::isfinite(rms))
    text << "marks fit to " << with_digits(rms, 3) << " px";
  if (const double rms = held_out_px(station, residuals); std::isfinite(rms))
    text << ", those held out to " << with_digits(rms, 3) << " px";
  text << ": ";
  for (const ControlResidual& residual : residuals) {
    text << (&residual == &residuals.front() ? "" : ", ") << residual.name;
    if (station.resection && residual.check) text << " (check)";
    if (std::isnan(residual.length_px())) {
      text << " behind the camera";
    } else {
      text << " " << with_digits(residual.length_px(), 3);
    }
  }
  return text.str();
}

Json control_json(const StationFile& station) {
  const std::vector<ControlResidual> residuals = control_residuals(station);
  if (residuals.empty()) return nullptr;
  return {{"use", station.resection ? "resection" : "check"},
          {"rms_px", fields_to_json(fit_px(station, residuals))},
          {"check_rms_px", fields_to_json(held_out_px(station, residuals))},
          {"center_sigma", station.resection ? fields_to_json(station.resection->center_sigma) : Json(nullptr)},
          {"doubtful", station.resection ? fields_to_json(station.resection->doubtful) : Json(nullptr)},
          {"points", fields_to_json(residuals)}};
}

}  // namespace malus
