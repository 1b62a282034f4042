#include "malus/capture/capture.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "malus/capture/mosaic.h"
#include "malus/capture/noise.h"
#include "malus/capture/resampling.h"
#include "malus/capture/response.h"
#include "malus/core/parallel.h"

namespace malus {
namespace {

constexpr double all_saturated = 0.99;

/// Linear images before registration.
struct Exposures {
  std::vector<Image<float>> images;
  std::vector<Mask> saturated;
  std::vector<std::string> names;
  NoiseModel noise;
  bool color = false;
};

void check_input(const CaptureInput& input) {
  const PolarizedSpec& spec = input.polarized;
  if (input.names.empty()) throw input_error("no polarized images");
  if (spec.mosaic) {
    if (input.names.size() != 1) {
      throw input_error("a mosaic station has one image, got " + std::to_string(input.names.size()));
    }
  } else if (spec.angles_deg && spec.angles_deg->size() != input.names.size()) {
    throw input_error("angles_deg has " + std::to_string(spec.angles_deg->size()) + " angles for " +
                      std::to_string(input.names.size()) + " images");
  }
  if (spec.angle_direction != "ccw" && spec.angle_direction != "cw") {
    throw input_error("angle_direction = \"" + spec.angle_direction + "\", expected \"ccw\" or \"cw\"");
  }
  if (spec.frames_averaged < 1) {
    throw input_error("frames_averaged = " + std::to_string(spec.frames_averaged) + ", expected 1 or more");
  }
  if ((spec.full_well_e && !(*spec.full_well_e > 0)) || (spec.read_noise_e && !(*spec.read_noise_e >= 0))) {
    throw input_error("full_well_e must be positive and read_noise_e not negative");
  }
}

std::vector<double> polarizer_angles_rad(const PolarizedSpec& spec) {
  std::vector<double> readings_deg;
  if (spec.mosaic) {
    readings_deg.assign(spec.mosaic->begin(), spec.mosaic->end());
  } else if (spec.angles_deg) {
    readings_deg = *spec.angles_deg;
  }
  const double sign = spec.angle_direction == "cw" ? -1 : 1;
  for (double& reading : readings_deg) reading = sign * (reading - spec.angle_zero_deg) * std::numbers::pi / 180;
  return readings_deg;
}

void require_same_size(const Image<float>& image, const std::string& name, const Image<float>& first,
                       const std::string& first_name) {
  if (image.size() != first.size()) {
    throw input_error(name + " is " + to_string(image.size()) + " pixels, but " + first_name + " is " +
                      to_string(first.size()) + "; all images of a station have one size");
  }
}

Exposures load_exposures(const CaptureInput& input, const ResponseCurve& curve, const CaptureOptions& options,
                         const Context& context) {
  const PolarizedSpec& spec = input.polarized;
  const std::array<double, 3> weights = channel_weights(spec);
  Exposures exposures;
  for (std::size_t k = 0; k < input.names.size(); ++k) {
    const std::string& name = input.names[k];
    context.progress("capture", 0, "reading " + name);
    const RawImage raw = input.load(k);
    const Levels levels = levels_of(raw, spec, options.saturation, name);
    LinearImage linear = linearize(raw, curve, levels, weights, name, context);
    if (k == 0) {
      exposures.color = is_color(raw) && !spec.mosaic;
      exposures.noise =
          noise_model(spec, curve, levels, exposures.color ? std::optional(weights) : std::nullopt, linear);
    } else {
      require_same_size(linear.intensity, name, exposures.images[0], input.names[0]);
    }
    exposures.names.push_back(name);
    exposures.images.push_back(std::move(linear.intensity));
    exposures.saturated.push_back(std::move(linear.saturated));
  }
  return exposures;
}

/// One mosaic → the images of its four polarizers.
void split_mosaic(Exposures& exposures, const Context& context) {
  auto channels = demosaic(exposures.images[0], exposures.saturated[0], exposures.names[0], context);
  exposures.images.clear();
  exposures.saturated.clear();
  for (MosaicChannel& channel : channels) {
    exposures.images.push_back(std::move(channel.intensity));
    exposures.saturated.push_back(std::move(channel.saturated));
  }
  exposures.names.resize(channels.size(), exposures.names[0]);
}

/// Registration of every image; identity for those that stay untouched.
std::vector<ImageRegistration> registrations(const Exposures& exposures, const CaptureOptions& options,
                                             const Context& context) {
  auto results = register_images(exposures.images, exposures.noise, options.registration, context);
  for (std::size_t k = 1; k < results.size(); ++k) {
    ImageRegistration& result = results[k];
    const bool automatic = options.mode == RegistrationMode::automatic;
    if (result.status == RegistrationStatus::no_texture && automatic) {
      context.log(LogLevel::warning, exposures.names[k] + " is used without registration: " + result.message);
      continue;
    }
    if (result.status != RegistrationStatus::ok) {
      throw data_error(exposures.names[k] + " cannot be registered to " + exposures.names[0] + ": " + result.message +
                       ". If the camera did not move, set capture.registration = \"off\"");
    }
    if (automatic && result.displacement_px < std::max(options.keep_below_px, 3 * result.rms_px)) {
      result.rms_px = std::hypot(result.rms_px, result.displacement_px);
      result.image_from_base = identity_affine();
    }
  }
  return results;
}

void clear_outside(Mask& mask, const Mask& keep) {
  for (std::size_t i = 0; i < mask.count(); ++i) mask[i] = mask[i] && keep[i] ? 255 : 0;
}

void add_flags(Mask& flags, const Mask& more) {
  for (std::size_t i = 0; i < flags.count(); ++i) flags[i] |= more[i];
}

/// The object in the undistorted raster: the mask at the nearest captured pixel.
Mask resample_mask(const Mask& mask, const ResamplingMap& map, const Context& context) {
  if (map.is_identity()) return mask;
  Mask result(mask.size());
  parallel_rows(context, mask.height(), [&](int v) {
    for (int u = 0; u < mask.width(); ++u) {
      const Eigen::Vector2d at = map(u, v);
      if (!(at.x() > -0.5 && at.y() > -0.5 && at.x() < mask.width() - 0.5 && at.y() < mask.height() - 0.5)) continue;
      result(u, v) = mask(static_cast<int>(std::lround(at.x())), static_cast<int>(std::lround(at.y())));
    }
  });
  return result;
}

/// Moves the images into the stack, through the one resampling.
void resample_exposures(Exposures& exposures, const std::optional<LensCamera>& lens, Interpolation interpolation,
                        PolarizedStack& stack, const Context& context) {
  const Size size = exposures.images[0].size();
  stack.saturated = Mask(size);
  for (std::size_t k = 0; k < exposures.images.size(); ++k) {
    const ResamplingMap map(lens, stack.image_from_base[k]);
    context.progress("capture", static_cast<double>(k) / static_cast<double>(exposures.images.size()), "resampling");
    const Image<float> source = std::move(exposures.images[k]);
    Resampled resampled = resample(source, size, map, interpolation, context);
    clear_outside(stack.mask, resampled.valid);
    add_flags(stack.saturated, resample_flags(exposures.saturated[k], size, map, context));
    stack.images.push_back(std::move(resampled.image));
  }
}

/// Mean over the images of their linear colours; a second pass over the files keeps one colour image in memory.
Image<float> mean_color(const CaptureInput& input, const ResponseCurve& curve, const CaptureOptions& options,
                        const PolarizedStack& stack, const Context& context) {
  Image<float> mean(stack.mask.size(), 3);
  const auto share = 1 / static_cast<float>(input.names.size());
  for (std::size_t k = 0; k < input.names.size(); ++k) {
    const RawImage raw = input.load(k);
    if (raw.pixels.channels() != 3)
      throw input_error(input.names[k] + " is grey, but " + input.names[0] + " is a colour image");
    require_size(raw.pixels, mean.size(), input.names[k]);
    const Levels levels = levels_of(raw, input.polarized, options.saturation, input.names[k]);
    const ResamplingMap map(input.lens, stack.image_from_base[k]);
    const Image<float> color = resample(linearize_color(raw, curve, levels, context), mean.size(), map,
                                        options.registration.interpolation, context)
                                   .image;
    for (std::size_t i = 0; i < mean.count(); ++i) mean[i] += share * color[i];
  }
  return mean;
}

void check_usable(const PolarizedStack& stack) {
  std::size_t object = 0, saturated = 0;
  for (std::size_t i = 0; i < stack.mask.count(); ++i) {
    if (!stack.mask[i]) continue;
    ++object;
    saturated += stack.saturated[i] != 0;
  }
  if (object == 0) throw data_error("no pixel of the object lies inside all polarized images (mask and undistortion)");
  if (static_cast<double>(saturated) > all_saturated * static_cast<double>(object)) {
    throw data_error(
        "more than 99 % of the object is saturated in the polarized images: expose less, or check white_level");
  }
}

}  // namespace

CaptureInput capture_input(const PolarizedSpec& polarized, const std::optional<LensCamera>& lens) {
  CaptureInput input;
  input.polarized = polarized;
  input.lens = lens;
  for (const auto& path : polarized.images) input.names.push_back(path.string());
  input.load = [paths = polarized.images](std::size_t index) { return read_image(paths[index], "polarized image"); };
  if (polarized.mask) input.mask = read_mask(*polarized.mask);
  return input;
}

PolarizedStack capture_stack(const CaptureInput& input, const CaptureOptions& options, const Context& context) {
  validate_fields(options, "capture");
  check_input(input);
  const ResponseCurve curve = response_curve(input.polarized.response, "response");
  Exposures exposures = load_exposures(input, curve, options, context);
  const Size size = exposures.images[0].size();
  if (input.mask) require_size(*input.mask, size, input.polarized.mask ? "mask " + input.polarized.mask->string() : "mask");
  if (input.lens && input.lens->size != size) {
    throw input_error(input.names[0] + " is " + to_string(size) + " pixels, but its camera is " +
                      to_string(input.lens->size));
  }

  PolarizedStack stack;
  stack.angles_rad = polarizer_angles_rad(input.polarized);
  stack.noise = exposures.noise;
  stack.camera = input.lens ? input.lens->pinhole() : Pinhole{.size = size};
  if (input.polarized.mosaic) split_mosaic(exposures, context);
  const bool registering = options.mode != RegistrationMode::off && !input.polarized.mosaic;
  stack.image_from_base.assign(exposures.images.size(), identity_affine());
  stack.registration_rms_px.assign(exposures.images.size(), 0.0);
  if (registering) {
    const auto results = registrations(exposures, options, context);
    for (std::size_t k = 0; k < results.size(); ++k) {
      stack.image_from_base[k] = results[k].image_from_base;
      stack.registration_rms_px[k] = results[k].rms_px;
    }
  }
  const ResamplingMap base_map(input.lens, identity_affine());
  stack.mask = input.mask ? resample_mask(*input.mask, base_map, context) : Mask(size, 1, 255);
  resample_exposures(exposures, input.lens, options.registration.interpolation, stack, context);
  check_usable(stack);
  if (exposures.color) stack.color = mean_color(input, curve, options, stack, context);
  context.progress("capture", 1, "done");
  return stack;
}

}  // namespace malus
