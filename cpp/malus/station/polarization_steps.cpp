#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "malus/capture/capture_internal.h"
#include "malus/core/cell_values_internal.h"
#include "malus/core/degrees_internal.h"
#include "malus/core/depth_normals_internal.h"
#include "malus/core/digits_internal.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/evidence/image_order_internal.h"
#include "malus/evidence/response_check_internal.h"
#include "malus/lighting/light_internal.h"
#include "malus/polarization/decompose_internal.h"
#include "malus/polarization/frame_calibration_internal.h"
#include "malus/polarization/interpolation_error_internal.h"
#include "malus/polarization/pixel_curves_internal.h"
#include "malus/polarization/reflection_internal.h"
#include "malus/polarization/smoothing_internal.h"
#include "malus/polarization/unpolarized_internal.h"
#include "malus/station/check_inputs_internal.h"
#include "malus/station/step_functions_internal.h"

namespace malus {
namespace {

/// Share of the object's pixels from which misfits are worth a warning.
constexpr double many_misfits = 0.05;
/// Share from which misfits are the rule, and no measured polarization is reliable. Correct rendered stations have 0.13
/// at most.
constexpr double most_misfits = 0.5;
/// Least median over cells of the squared mean (s1, s2) divided by its variance from noise; without polarization it is
/// 0.7.
constexpr double least_polarization = 1.5;
/// What noise alone exceeds in one of a hundred cells, and the share of cells above it from which parts of the object
/// are polarized.
constexpr double beyond_noise = 4.6, some_cells = 0.05;
constexpr int polarization_cell_px = 8;
/// Median error of (s1, s2), relative to their length, from which a mosaic is worth a warning.
constexpr double texture_over_polarization = 1;

/// Finding for images that fit other angles or exposures, where the difference is too large for an error of reading.
Finding caution_of_angles(const PolarizerFit& fit, const std::vector<double>& given_rad) {
  std::ostringstream values;
  const auto list = [&](const auto& name, std::size_t count, const auto& value) {
    values << name << " [";
    for (std::size_t k = 0; k < count; ++k) values << (k > 0 ? ", " : "") << std::lround(value(k));
    values << "]";
  };
  // A polarizer turned by 180° is the same: each angle is given in the half turn about the one that was stated.
  list("angles", fit.angles_rad.size(), [&](std::size_t k) {
    return to_degrees(given_rad[k] + std::remainder(fit.angles_rad[k] - given_rad[k], std::numbers::pi));
  });
  list("° (counter-clockwise) and exposures", fit.gains.size(), [&](std::size_t k) { return 100 * fit.gains[k]; });
  return {Check::angles,
          Severity::caution,
          "the images fit other polarizer angles or exposures better than those given, but too far off for an error of "
          "reading: " +
              values.str() + " %",
          "are angles_deg what the scale said, in the order of the images, and were exposure, white balance and light "
          "left alone?",
          {{"largest_angle_change_deg", to_degrees(fit.largest_angle_change_rad)},
           {"largest_gain_change", fit.largest_gain_change}}};
}

/// Fits angles and exposures to the images where the options ask for it. If the fit is used, the stack gets its angles
/// and is corrected for its exposures. Returns a finding if the images fit implausible values better.
std::optional<Finding> fit_polarizer_of(PolarizedStack& stack, const PolarizedSpec& spec,
                                        const PolarizerOptions& options, MeasuredPolarization& measured,
                                        const Context& context) {
  const bool free_angles = !spec.angles_deg, fits = stack.images.size() > 3 && !spec.mosaic;
  if (free_angles && options.calibrate_angles == AngleCalibration::off) {
    throw input_error(
        "polarizer.calibrate_angles = \"off\" leaves angles_deg = \"auto\" unknown, expected angles in degrees");
  }
  PolarizerFit& fit = measured.polarizer;
  std::optional<Finding> caution;
  if (free_angles || (fits && options.calibrate_angles != AngleCalibration::off)) {
    fit = fit_polarizer(stack.images, stack.angles_rad, stack.noise, stack.mask, stack.saturated, options, context);
    measured.polarizer_fitted = free_angles || options.calibrate_angles == AngleCalibration::on ||
                                (fit.improvement() > options.min_improvement && fit.is_plausible(options));
    if (!free_angles && fit.improvement() > options.min_improvement && !fit.is_plausible(options))
      caution = caution_of_angles(fit, stack.angles_rad);
  } else {
    fit = polarizer_as_given(stack.angles_rad, options);
  }
  if (!measured.polarizer_fitted) {
    fit.angles_rad = stack.angles_rad;
    fit.gains.assign(stack.images.size(), 1.0);
    return caution;
  }
  stack.angles_rad = fit.angles_rad;
  for (std::size_t k = 0; k < stack.images.size(); ++k) {
    const auto share = static_cast<float>(1 / fit.gains[k]);
    Image<float>& image = stack.images[k];
    parallel_rows(context, image.height(), [&](int v) {
      std::for_each(image.row(v), image.row(v) + image.width(), [share](float& value) { value *= share; });
    });
  }
  return caution;
}

/// Finding for images that could not be registered: a shift between them looks like polarization at every edge.
std::optional<Finding> caution_of_registration(const PolarizedStack& stack) {
  const std::size_t count = stack.unregistered.size();
  if (count == 0) return std::nullopt;
  return Finding{Check::registration,
                 Severity::caution,
                 "used without registration: " + std::to_string(count) + " of the " +
                     std::to_string(stack.images.size()) + " polarized images, whose places could not be found",
                 "if the camera did not move, capture.registration = \"off\" says so",
                 {}};
}

/// What the order of the images says, in words for a mosaic, whose file and station file have no images.
Finding order_in_mosaic(const ImageOrder& order) {
  Finding finding = order.finding;
  if (finding.severity != Severity::warning) return finding;
  std::array<long, 4> cell{};
  for (std::size_t k = 0; k < cell.size(); ++k) {
    const double degrees = to_degrees(order.angles_rad[k]);
    cell[k] = std::lround(degrees - 180 * std::floor(degrees / 180));
  }
  // Eight orders fit alike, turned by 45° or mirrored; among them that of the common sensors.
  if (std::abs(cell[0] - cell[3]) == 90) cell = {90, 45, 135, 0};
  std::ostringstream fits;
  fits << "is mosaic = [[" << cell[0] << ", " << cell[1] << "], [" << cell[2] << ", " << cell[3]
       << "]] right, or that of a turned, mirrored or cropped image?";
  finding.message =
      "the angles of the mosaic's cell do not seem to be in its order: in another order the squared misfit of the "
      "sinusoid is " +
      with_digits(order.misfit_ratio, 2) + " times smaller";
  finding.suggestion = fits.str();
  return finding;
}

/// Finding for many pixels that do not follow the sinusoid. Single ones are only left out; many have a common cause. A
/// note says where three angles show none, however much the light flickered.
std::optional<Finding> finding_of_misfits(const PolarizationState& state) {
  if (state.angles_rad.size() < 4) {
    return Finding{Check::misfits,
                   Severity::note,
                   "whether the light flickered or something moved could not be checked: a sinusoid passes through any "
                   "three values; images at a fourth angle would show it",
                   "",
                   {}};
  }
  std::size_t object_pixels = 0, misfit_pixels = 0;
  for (const std::uint8_t pixel : state.valid) {
    object_pixels += !has_state(pixel, PixelState::outside);
    misfit_pixels += has_state(pixel, PixelState::misfit);
  }
  const auto object = static_cast<double>(object_pixels), misfits = static_cast<double>(misfit_pixels);
  if (misfits <= many_misfits * object) return std::nullopt;
  return Finding{Check::misfits,
                 misfits > most_misfits * object ? Severity::warning : Severity::caution,
                 percent(misfits / object) + " of the object's pixels do not follow the polarizer's sinusoid",
                 "is `response` right, did the light change, did something move?",
                 {{"misfit_fraction", misfits / object}}};
}

/// Squared mean of (s1, s2) in a cell divided by its variance, which is scaled by the residuals.
std::optional<double> polarization_of_cell(const PolarizationState& state, int column, int row) {
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  double variance = 0, residuals = 0;
  int pixels = 0;
  for_each_pixel(cell_rect(column, row, polarization_cell_px, state.size()), [&](int u, int v) {
    if (!state.is_valid(u, v)) return;
    const Eigen::Matrix3d covariance = state.stokes_covariance(u, v);
    sum += state.stokes(u, v).tail<2>();
    variance += covariance(1, 1) + covariance(2, 2);
    residuals += std::pow(state.residual(u, v), 2);
    ++pixels;
  });
  if (pixels < polarization_cell_px || !(variance > 0) || !(residuals > 0)) return std::nullopt;
  return sum.squaredNorm() / (variance * residuals / pixels);
}

/// Finding for images that are the same at all angles: no polarizer was in front of the lens, or it had no effect.
std::optional<Finding> caution_of_no_polarization(const PolarizationState& state) {
  constexpr double most_cells = 20000;
  const Size all = cells_over(state.size(), polarization_cell_px);
  const double share_of_cells =
      share_of_set(state.valid_pixels(), most_cells * polarization_cell_px * polarization_cell_px);
  std::vector<double> cells;
  for_each_pixel(all, [&](int column, int row) {
    const auto number = static_cast<std::size_t>(row) * all.width + column;
    if (!is_chosen(number, share_of_cells)) return;
    if (const auto found = polarization_of_cell(state, column, row)) cells.push_back(*found);
  });
  if (cells.empty()) return std::nullopt;
  const double typical = median_in_place(cells);
  if (typical > least_polarization) return std::nullopt;
  const auto polarized = std::ranges::count_if(cells, [](double cell) { return cell > beyond_noise; });
  const double share = static_cast<double>(polarized) / static_cast<double>(cells.size());
  const std::vector<std::pair<std::string, double>> figures{{"polarization_over_noise", typical},
                                                            {"polarized_fraction", share}};
  if (share > some_cells) {
    return Finding{Check::polarization, Severity::caution,
                   "only " + percent(share) + " of the object is polarized beyond the noise",
                   "is the background in the mask? Average more exposures, or light the object from the side", figures};
  }
  return Finding{Check::polarization, Severity::caution,
                 "the images are the same at all angles of the polarizer, but for noise: nothing is polarized",
                 "did a linear polarizer turn before the lens? A circular one works only with its thread towards the "
                 "camera",
                 figures};
}

/// Finding for images interpolated from a mosaic: texture finer than its cells looks like polarization.
std::optional<Finding> caution_of_texture(const PolarizationState& state) {
  std::vector<double> errors;
  for (int v = 0; v < state.size().height; v += 4) {
    for (int u = 0; u < state.size().width; u += 4) {
      if (!state.is_valid(u, v)) continue;
      const Eigen::Matrix3d covariance = state.stokes_covariance(u, v);
      const double s0 = 2.0 * state.i_un(u, v), linear = s0 * std::max<double>(state.rho(u, v), 1e-6);
      errors.push_back(std::sqrt(0.5 * (covariance(1, 1) + covariance(2, 2))) / linear);
    }
  }
  if (errors.empty()) return std::nullopt;
  const double error = median_in_place(errors);
  if (error < texture_over_polarization) return std::nullopt;
  return Finding{Check::texture,
                 Severity::caution,
                 "texture finer than the mosaic's cells is as strong as the polarization on most of the object: the "
                 "fused detail may be worse than the prior's",
                 "come closer, stop the lens down, or turn a filter before an ordinary camera",
                 {{"texture_over_polarization", error}}};
}

/// Known reflection, light and scale, for the comparison of the polarization with the prior.
FrameHints frame_hints(const Job& job, const PolarizationState& state, const StationView& view,
                       const Image<float>& normals) {
  const OpticsSpec& optics = job.station.file.optics;
  FrameHints hints;
  hints.known_scale = job.station.file.polarized.angles_deg.has_value();
  if (optics.reflection == ReflectionChoice::diffuse) hints.specular = false;
  if (optics.reflection == ReflectionChoice::specular) hints.specular = true;
  if (optics.refractive_index) hints.refractive_index = *optics.refractive_index;
  const LightEstimate light =
      estimate_light(state.i_un, normals, state.valid_pixels(), &view.camera, job.options.light, job.context);
  if (light.status == LightStatus::estimated) hints.light = light.coefficients.head<3>();
  return hints;
}

/// Calibrates the polarizer's scale by the surface, if there is a surface.
CalibratedFrame compare_with_surface(const Job& job, const MeasuredPolarization& measured, const StationView& view,
                                     const DepthPrior* prior) {
  const PolarizedSpec& polarized = job.station.file.polarized;
  const bool known_scale = polarized.angles_deg.has_value();
  if (prior == nullptr)
    return {calibration_without_surface(measured.polarizer, measured.polarizer_fitted, known_scale)};
  const PolarizerOptions& options = job.options.polarizer;
  const Image<float> normals = normals_from_depth(prior->depth, view.camera, job.context);
  const FrameHints hints = frame_hints(job, *measured.state, view, normals);
  const FrameEstimate surface = estimate_frame(*measured.state, &view.camera, normals, hints, options, job.context);
  return calibrate_frame(measured.polarizer, measured.polarizer_fitted, known_scale, surface, options,
                         polarized.mosaic.has_value());
}

}  // namespace

std::tuple<MeasuredPolarization, StationView, ObjectColor, Scene, ImageFindings> measure_polarization(const Job& job) {
  const Options& options = job.options;
  const Context& context = job.context;
  PolarizedStack stack = capture_stack(make_capture_input(job.station), options.capture, context);
  const PolarizedSpec& polarized = job.station.file.polarized;
  ImageFindings of_images;
  // Logged here and not by the step that judges all findings, because a run may end before that step or not need it.
  const auto add = [&](Finding found) {
    if (found.severity != Severity::note) context.log(LogLevel::warning, found.text());
    of_images.findings.push_back(std::move(found));
  };
  const auto add_if_any = [&](std::optional<Finding> found) {
    if (found) add(*std::move(found));
  };
  // Angles that are estimated from the images follow the images' order, which therefore need not be checked.
  if (polarized.angles_deg) {
    const ImageOrder order = check_image_order(stack.images, stack.angles_rad, stack.mask, context);
    add(polarized.mosaic ? order_in_mosaic(order) : order.finding);
  }
  const auto check_linear = [&] {
    return check_response(stack.images, stack.angles_rad, stack.mask, polarized.response, context).finding;
  };
  std::optional<Finding> as_read;
  if (polarized.angles_deg) as_read = check_linear();
  MeasuredPolarization measured;
  const std::optional<Finding> angles = fit_polarizer_of(stack, polarized, options.polarizer, measured, context);
  Finding response = check_linear();
  if (as_read) response = response_finding(*as_read, response);
  add(response);
  for (Finding finding : job.station.file_findings) {
    // The measured response is stronger evidence than metadata that a program wrote into a file. It does not tell one
    // display's curve from another's.
    if (finding.check == Check::encoding && says_linear(response)) {
      finding.severity = Severity::note;
      finding.message += "; the measured brightness shows that this is right";
      finding.suggestion.clear();
    }
    add(std::move(finding));
  }
  auto state = std::make_shared<PolarizationState>(decompose(stack.images, stack.angles_rad, stack.noise, stack.mask,
                                                             stack.saturated, options.polarization, context));
  const bool moved =
      std::ranges::any_of(stack.image_from_base, [](const Affine& map) { return map != identity_affine(); });
  if (moved) smooth_polarization(*state, context);
  // Not logged: each unregistered image was already reported.
  if (auto found = caution_of_registration(stack)) of_images.findings.push_back(*std::move(found));
  add_if_any(angles);
  if (!stack.shared.empty()) {
    add_interpolation_error(*state, stack.shared, context);
    add_if_any(caution_of_texture(*state));
  }
  add_if_any(finding_of_misfits(*state));
  // A polarization camera is never without its filters, and its errors from texture would count as noise.
  if (stack.shared.empty()) add_if_any(caution_of_no_polarization(*state));
  measured.curves = pixel_curves(*state, stack.images, stack.angles_rad, job.station.file.polarized.curve_pixels);
  measured.state = std::move(state);
  Scene scene;
  const bool has_surroundings = std::ranges::find(stack.mask, std::uint8_t{0}) != stack.mask.end();
  if (job.station.file.photos || has_surroundings)
    scene.image = unpolarized_intensity(stack.images, stack.angles_rad, context);
  return {std::move(measured), StationView{stack.camera, std::move(stack.registration_rms_px)},
          ObjectColor{std::move(stack.color)}, std::move(scene), std::move(of_images)};
}

CalibratedPolarization calibrate_polarization(const Job& job, const MeasuredPolarization& measured,
                                              const StationView& view, const DepthPrior* prior) {
  CalibratedFrame calibrated = compare_with_surface(job, measured, view, prior);
  for (const std::string& warning : calibrated.calibration.warnings) job.context.log(LogLevel::warning, warning);
  if (!calibrated.calibration.from_surface) return {measured.state, std::move(calibrated.calibration)};
  auto state = std::make_shared<PolarizationState>(*measured.state);
  apply_frame(*state, calibrated.frame, job.context);
  return {std::move(state), std::move(calibrated.calibration)};
}

std::tuple<ReflectionMap, ClampedZeniths> find_zenith(const Job& job, const CalibratedPolarization& polarization,
                                                      const StationView& view, const DepthPrior* prior) {
  const StationFile& file = job.station.file;
  ReflectionOptions known = job.options.reflection;
  if (file.optics.refractive_index) known.refractive_index = *file.optics.refractive_index;
  known.reflection = file.optics.reflection;
  const Image<std::uint8_t> labels = labels_in_view(job.station, job.context);
  Image<float> normals;
  if (prior != nullptr) normals = normals_from_depth(prior->depth, view.camera, job.context);
  // Without a camera the rays are assumed parallel.
  const Pinhole* camera = file.known_lens() ? &view.camera : nullptr;
  const PolarizationState& state = *polarization.state;
  ReflectionMap map = map_reflection(state, camera, prior != nullptr ? &normals : nullptr,
                                     labels.empty() ? nullptr : &labels, known, job.context);
  ClampedZeniths clamped{Mask(state.size()), map.clamped_share};
  const double largest = largest_diffuse_degree(map.refractive_index);  // Eq 8 reaches 1
  for (std::size_t i = 0; i < clamped.map.count(); ++i) {
    const bool is_diffuse = map.label[i] == static_cast<std::uint8_t>(Reflection::diffuse);
    clamped.map[i] = is_diffuse && state.rho[i] > largest ? 255 : 0;
  }
  return {std::move(map), std::move(clamped)};
}

}  // namespace malus
