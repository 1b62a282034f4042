#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "malus/capture/affine_displacement_internal.h"
#include "malus/capture/alike_images_internal.h"
#include "malus/capture/capture_internal.h"
#include "malus/capture/mosaic_internal.h"
#include "malus/capture/noise_internal.h"
#include "malus/capture/resampling_internal.h"
#include "malus/capture/response_internal.h"
#include "malus/core/degrees_internal.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_sums_internal.h"

namespace malus {
namespace {

constexpr double all_saturated = 0.99;
/// Number of mask pixels that a thread takes at a time.
constexpr std::size_t flags_at_once = 1 << 18;

/// Linear images before registration.
struct Exposures {
  std::vector<Image<float>> images;
  std::vector<Mask> saturated;
  std::vector<std::string> names;
  NoiseModel noise;
  bool color = false;
};

/// For programs that embed the library: files and Python's arrays are checked before.
void check_exposures(const PolarizedSpec& spec, std::size_t images) {
  const std::vector<double>& times = *spec.exposure_s;
  if (spec.mosaic || !spec.angles_deg) throw input_error("exposure_s needs known angles, one per image");
  if (times.size() != images) {
    throw input_error("exposure_s has " + std::to_string(times.size()) + " times for " + std::to_string(images) +
                      " images, expected one for each");
  }
  if (!std::ranges::all_of(times, [](double time) { return time > 0 && std::isfinite(time); }))
    throw input_error("exposure_s must be positive");
}

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
  if (spec.exposure_s) check_exposures(spec, input.names.size());
  if (input.lens) input.lens->validate("[camera]");
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
  const double sign = spec.angle_direction == AngleDirection::clockwise ? -1 : 1;
  for (double& reading : readings_deg) reading = to_radians(sign * (reading - spec.angle_zero_deg));
  return readings_deg;
}

void require_same_size(const Image<float>& image, const std::string& name, const Image<float>& first,
                       const std::string& first_name) {
  if (image.size() != first.size()) {
    throw input_error(name + " is " + to_string(image.size()) + " pixels, but " + first_name + " is " +
                      to_string(first.size()) + "; all images of a station have one size");
  }
}

/// Images of one polarizer position that only differ in exposure.
using Group = std::vector<std::size_t>;

/// The images to be merged, in order of first appearance; one group per image when exposures do not differ.
std::vector<Group> exposure_groups(const PolarizedSpec& spec, std::size_t count) {
  std::vector<Group> groups;
  std::map<double, std::size_t> group_of_angle;
  for (std::size_t k = 0; k < count; ++k) {
    if (!spec.exposure_s) {
      groups.push_back({k});
      continue;
    }
    const auto [found, added] = group_of_angle.emplace((*spec.angles_deg)[k], groups.size());
    if (added) groups.emplace_back();
    groups[found->second].push_back(k);
  }
  return groups;
}

/// Exposure of an image over the shortest one.
double exposure_ratio(const PolarizedSpec& spec, std::size_t k) {
  return spec.exposure_s ? (*spec.exposure_s)[k] / std::ranges::min(*spec.exposure_s) : 1.0;
}

/// Noise of a group's mean, at the level of the shortest exposure: electrons add up where nothing is saturated.
/// `unsaturated`: share of unsaturated pixels of each image.
NoiseModel merged_noise(const NoiseModel& noise, const std::vector<double>& ratios,
                        const std::vector<double>& unsaturated) {
  double sum = 0, squares = 0;
  for (std::size_t k = 0; k < ratios.size(); ++k) {
    sum += unsaturated[k] * ratios[k];
    squares += unsaturated[k] * ratios[k] * ratios[k];
  }
  NoiseModel merged = noise;
  merged.full_well_e = sum * noise.full_well_e;
  merged.read_noise_e = noise.read_noise_e * sum / std::sqrt(squares);
  merged.quantization = noise.quantization / std::sqrt(squares);
  return merged;
}

Exposures load_exposures(const CaptureInput& input, const ResponseCurve& curve, const CaptureOptions& options,
                         const Context& context) {
  const PolarizedSpec& spec = input.polarized;
  const std::array<double, 3> weights = channel_weights(spec);
  const std::size_t count = input.names.size();
  Exposures exposures;
  exposures.names = input.names;
  exposures.images.resize(count);
  exposures.saturated.resize(count);
  std::vector<std::string> doubts(count);
  context.progress("capture", 0, "reading " + std::to_string(count) + " images");
  parallel_for(context, count, 1, [&](std::size_t k, std::size_t) {
    RawImage raw = input.load(k);
    const Levels levels = levels_of(raw, spec, curve, options.saturation, input.names[k]);
    require_numbers_of_table(raw, levels, curve, input.names[k]);
    doubts[k] = doubt_of_white_level(raw, levels, input.names[k]);
    LinearImage linear = linearize(std::move(raw), curve, levels, weights, input.names[k], context);
    if (spec.mosaic && linear.color) {
      throw input_error(input.names[k] +
                        ": is a color image, expected the samples of the polarization camera's sensor, one a pixel; a "
                        "program that made colors of them mixed its polarizers");
    }
    if (k == 0) {
      exposures.color = linear.color;
      exposures.noise =
          noise_model(spec, curve, levels, exposures.color ? std::optional(weights) : std::nullopt, linear);
    }
    const auto share = static_cast<float>(1 / exposure_ratio(spec, k));
    if (spec.exposure_s) std::ranges::for_each(linear.intensity, [share](float& value) { value *= share; });
    exposures.images[k] = std::move(linear.intensity);
    exposures.saturated[k] = std::move(linear.saturated);
  });
  for (std::size_t k = 1; k < count; ++k) {
    require_same_size(exposures.images[k], input.names[k], exposures.images[0], input.names[0]);
  }
  const auto doubt = std::ranges::find_if(doubts, [](const std::string& some) { return !some.empty(); });
  if (doubt != doubts.end()) context.log(LogLevel::warning, *doubt);
  return exposures;
}

/// One mosaic → the images of its four polarizers; for a color camera, the weighted sum of the colors, and the colors'
/// mean over the polarizers as `color`.
/// `shared`: MosaicSplit::shared.
void split_mosaic(Exposures& exposures, const PolarizedSpec& spec, Image<float>& color, Image<float>& shared,
                  const Context& context) {
  const Image<float> mosaic = std::move(exposures.images[0]);
  const std::string name = exposures.names[0];
  const std::string doubt = doubt_of_colors(mosaic, spec.mosaic_colors, name);
  if (!doubt.empty()) context.log(LogLevel::warning, doubt);
  const std::array<double, 3> weights = channel_weights(spec);
  const auto single = static_cast<std::size_t>(std::ranges::find(weights, 1.0) - weights.begin());
  const bool of_one_color = spec.mosaic_colors && single < weights.size();
  // A pixel depends on samples up to 3 px away: on its neighbors, whose contrasts are smoothed over their neighbors. In
  // color it is up to 4 px; samples of a single color are first interpolated over 2 px.
  const Mask saturated = spread_flags(exposures.saturated[0], of_one_color ? 5 : spec.mosaic_colors ? 4 : 3);
  exposures.images.assign(4, {});
  if (!spec.mosaic_colors) {
    MosaicSplit split = demosaic(mosaic, name, context);
    std::ranges::move(split.channels, exposures.images.begin());
    shared = std::move(split.shared);
  } else {
    ColorMosaic split = demosaic_color(mosaic, *spec.mosaic_colors, name, context);
    color = Image<float>(mosaic.size(), 3);
    for (std::size_t i = 0; i < mosaic.count(); ++i) {
      float mean = 0, factor = 0;
      for (const Image<float>& channel : split.gray.channels) mean += 0.25f * channel[i];
      for (std::size_t c = 0; c < 3; ++c) {
        color[3 * i + c] = split.ratios[c][i] * mean;
        factor += static_cast<float>(weights[c]) * split.ratios[c][i];
      }
      for (Image<float>& channel : split.gray.channels) channel[i] *= factor;
    }
    std::ranges::move(split.gray.channels, exposures.images.begin());
    shared = std::move(split.gray.shared);
    // Users select a single color because the colors are polarized differently.
    if (of_one_color) {
      MosaicSplit plane = demosaic(split_colors(mosaic, *spec.mosaic_colors, name, context)[single], name, context);
      std::ranges::move(plane.channels, exposures.images.begin());
    }
  }
  exposures.saturated.assign(4, saturated);
  exposures.names.assign(4, name);
}

/// Which images cannot be registered, and why. All images are registered together, so one bad image can make all fail.
/// Therefore names the images that also fail alone against the first one, if there are any; or the first one, if all
/// others fail against it although two of them fit each other.
std::string failed_registration(const Exposures& exposures, const std::vector<ImageRegistration>& results,
                                const RegistrationOptions& options, const Context& context) {
  const auto alone_against = [&](std::size_t base, std::size_t k) {
    return register_images({exposures.images[base], exposures.images[k]}, exposures.noise, options, context)[1];
  };
  struct Failed {
    std::vector<std::size_t> images;
    std::string why;
    void add(std::size_t image, const std::string& message) {
      images.push_back(image);
      if (why.empty()) why = message;
    }
  } together, alone;
  for (std::size_t k = 1; k < results.size(); ++k) {
    if (results[k].status == RegistrationStatus::ok) continue;
    together.add(k, results[k].message);
    const ImageRegistration pair = alone_against(0, k);
    if (pair.status != RegistrationStatus::ok) alone.add(k, pair.message);
  }
  const Failed& failed = alone.images.empty() ? together : alone;
  const bool first_is_bad = results.size() > 2 && alone.images.size() + 1 == results.size() &&
                            alone_against(1, 2).status == RegistrationStatus::ok;
  std::string names;
  for (const std::size_t k : failed.images) names += (names.empty() ? "" : ", ") + exposures.names[k];
  return (first_is_bad ? exposures.names[0] + " cannot be registered to the other images"
                       : names + " cannot be registered to " + exposures.names[0]) +
         ": " + failed.why + ". If the camera did not move, set capture.registration = \"off\"";
}

/// Whether nothing is known of an image's place; it may still be where the first image is.
bool has_no_place(RegistrationStatus status) {
  return status == RegistrationStatus::no_texture || status == RegistrationStatus::uncertain ||
         status == RegistrationStatus::strayed;
}

/// Registration of every image; identity for those that stay unchanged. Adds images whose place is not found to
/// `unregistered`, where they may stay unchanged.
std::vector<ImageRegistration> registrations(const Exposures& exposures, const CaptureOptions& options,
                                             std::vector<std::string>& unregistered, const Context& context) {
  auto results = register_images(exposures.images, exposures.noise, options.registration, context);
  for (std::size_t k = 1; k < results.size(); ++k) {
    ImageRegistration& result = results[k];
    const bool automatic = options.mode == RegistrationMode::automatic;
    if (has_no_place(result.status) && automatic) {
      context.log(LogLevel::warning, exposures.names[k] + " is used without registration: " + result.message);
      unregistered.push_back(exposures.names[k]);
      continue;
    }
    if (result.status != RegistrationStatus::ok) {
      throw data_error(failed_registration(exposures, results, options.registration, context));
    }
    if (automatic && result.displacement_px < std::max(options.keep_below_px, 3 * result.rms_px)) {
      result.rms_px = std::hypot(result.rms_px, result.displacement_px);
      result.image_from_base = identity_affine();
    }
  }
  return results;
}

void clear_outside(Mask& mask, const Mask& keep, const Context& context) {
  parallel_for(context, mask.count(), flags_at_once, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) mask[i] = mask[i] && keep[i] ? 255 : 0;
  });
}

/// Adds the flags of another mask; empty `flags` become a copy of it.
void add_flags(Mask& flags, Mask more, const Context& context) {
  if (flags.empty()) {
    flags = std::move(more);
    return;
  }
  parallel_for(context, flags.count(), flags_at_once, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) flags[i] |= more[i];
  });
}

/// One image after resampling; valid on the object, where the support of all its pixels lies in the source.
struct Layer {
  Image<float> intensity;
  Mask saturated;
};

Layer resample_layer(Exposures& exposures, std::size_t k, const ResamplingMap& map, Mask& object,
                     const Context& context) {
  Image<float> source = std::move(exposures.images[k]);
  if (map.is_identity()) return {std::move(source), std::move(exposures.saturated[k])};
  Resampled resampled = resample(std::move(source), object.size(), map, context);
  clear_outside(object, resampled.valid, context);
  return {std::move(resampled.image), resample_flags(exposures.saturated[k], object.size(), map, context)};
}

/// Mean of a group by inverse variance over its unsaturated images; the shortest exposure where all are saturated.
Layer merge(std::vector<Layer> layers, const std::vector<double>& ratios, const NoiseModel& noise,
            const Context& context) {
  // The shortest exposure saturates last, so the weights of all images follow from its signal.
  Layer& merged = layers[static_cast<std::size_t>(std::ranges::min_element(ratios) - ratios.begin())];
  parallel_for(context, merged.intensity.count(), 1 << 18, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const double signal = merged.intensity[i];
      double sum = 0, weights = 0;
      for (std::size_t k = 0; k < layers.size(); ++k) {
        if (layers[k].saturated[i]) continue;
        const double weight = ratios[k] * ratios[k] / noise.variance(signal * ratios[k]);
        sum += weight * layers[k].intensity[i];
        weights += weight;
      }
      if (weights > 0) merged.intensity[i] = static_cast<float>(sum / weights);
      merged.saturated[i] = weights > 0 ? 0 : 255;
    }
  });
  return std::move(merged);
}

/// Resamples the images into the stack, one per polarizer position.
void fill_stack(Exposures& exposures, const CaptureInput& input, const std::vector<Affine>& maps,
                const std::vector<Group>& groups, PolarizedStack& stack, const Context& context) {
  for (std::size_t g = 0; g < groups.size(); ++g) {
    context.progress("capture", static_cast<double>(g) / static_cast<double>(groups.size()), "resampling");
    std::vector<Layer> layers;
    std::vector<double> ratios, unsaturated;
    for (const std::size_t k : groups[g]) {
      const ResamplingMap map(input.lens, maps[k]);
      layers.push_back(resample_layer(exposures, k, map, stack.mask, context));
      ratios.push_back(exposure_ratio(input.polarized, k));
      if (groups[g].size() > 1) unsaturated.push_back(1 - share_within(layers.back().saturated, stack.mask));
    }
    if (layers.size() > 1 && g == 0) stack.noise = merged_noise(exposures.noise, ratios, unsaturated);
    Layer layer =
        layers.size() > 1 ? merge(std::move(layers), ratios, exposures.noise, context) : std::move(layers.front());
    add_flags(stack.saturated, std::move(layer.saturated), context);
    stack.images.push_back(std::move(layer.intensity));
  }
}

/// Linear color of image k, in its own pixels; the encoded image is freed.
Image<float> linear_color(const CaptureInput& input, std::size_t k, const ResponseCurve& curve,
                          const CaptureOptions& options, Size size, const Context& context) {
  const RawImage raw = input.load(k);
  if (raw.pixels.channels() != 3)
    throw input_error(input.names[k] + " is gray, but " + input.names[0] + " is a color image");
  require_size(raw.pixels, size, input.names[k]);
  const Levels levels = levels_of(raw, input.polarized, curve, options.saturation, input.names[k]);
  return linearize_color(raw, curve, levels, input.names[k], context);
}

/// Mean over the images (of the shortest exposure) of their linear colors; a second pass over the files, so that memory
/// holds one color image at a time.
Image<float> mean_color(const CaptureInput& input, const ResponseCurve& curve, const CaptureOptions& options, Size size,
                        const std::vector<Affine>& maps, const Context& context) {
  Image<float> mean(size, 3);
  float count = 0;
  for (std::size_t k = 0; k < input.names.size(); ++k) {
    if (exposure_ratio(input.polarized, k) > 1) continue;
    const ResamplingMap map(input.lens, maps[k]);
    const Image<float> color =
        resample(linear_color(input, k, curve, options, size, context), size, map, context).image;
    for (std::size_t i = 0; i < mean.count(); ++i) mean[i] += color[i];
    count += 1;
  }
  for (float& value : mean) value /= count;
  return mean;
}

void check_usable(const PolarizedStack& stack, const Context& context) {
  const auto [object, saturated] = sum_pixels<2>(stack.mask.count(), context, [&](std::size_t i, Sums<2>& sums) {
    if (stack.mask[i] == 0) return;
    sums[0] += 1;
    sums[1] += stack.saturated[i] != 0;
  });
  if (object == 0) throw data_error("no pixel of the object lies inside all polarized images (mask and undistortion)");
  if (saturated > all_saturated * object) {
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
  if (input.mask)
    require_size_of_images(*input.mask, size, input.polarized.mask ? "mask " + input.polarized.mask->string() : "mask");
  if (input.lens && input.lens->size != size) {
    throw input_error(input.names[0] + " is " + to_string(size) + " pixels, but its camera is " +
                      to_string(input.lens->size));
  }

  PolarizedStack stack;
  stack.angles_rad = polarizer_angles_rad(input.polarized);
  if (!input.polarized.mosaic && !input.polarized.exposure_s)
    require_alike_images(exposures.images, exposures.names, stack.angles_rad);
  stack.noise = exposures.noise;
  stack.camera = input.lens ? input.lens->pinhole() : Pinhole{.size = size};
  Image<float> mosaic_color, shared;
  if (input.polarized.mosaic) split_mosaic(exposures, input.polarized, mosaic_color, shared, context);
  const bool registering = options.mode != RegistrationMode::off && !input.polarized.mosaic;
  std::vector<Affine> maps(exposures.images.size(), identity_affine());
  std::vector<double> rms_px(exposures.images.size(), 0.0);
  if (registering) {
    const auto results = registrations(exposures, options, stack.unregistered, context);
    for (std::size_t k = 0; k < results.size(); ++k) {
      maps[k] = results[k].image_from_base;
      rms_px[k] = results[k].rms_px;
    }
  }
  const ResamplingMap base_map(input.lens, identity_affine());
  stack.mask = input.mask ? undistorted_mask(*input.mask, input.lens, context) : Mask(size, 1, 255);
  const std::vector<Group> groups = exposure_groups(input.polarized, exposures.images.size());
  fill_stack(exposures, input, maps, groups, stack, context);
  const std::vector<double> readings = std::move(stack.angles_rad);
  stack.angles_rad.clear();
  for (const Group& group : groups) {
    if (!readings.empty()) stack.angles_rad.push_back(readings[group.front()]);
    stack.image_from_base.push_back(maps[std::ranges::max(
        group, {}, [&](std::size_t k) { return affine_distance_px(maps[k], identity_affine(), size); })]);
    double worst = 0;
    for (const std::size_t k : group) worst = std::max(worst, rms_px[k]);
    stack.registration_rms_px.push_back(worst);
  }
  check_usable(stack, context);
  if (exposures.color) stack.color = mean_color(input, curve, options, size, maps, context);
  if (!shared.empty()) stack.shared = resample(std::move(shared), size, base_map, context).image;
  if (!mosaic_color.empty()) stack.color = resample(std::move(mosaic_color), size, base_map, context).image;
  context.progress("capture", 1, "done");
  return stack;
}

void require_size_of_images(const Mask& mask, Size images, const std::string& name) {
  if (mask.size() == images) return;
  const bool turned = mask.width() == images.height && mask.height() == images.width;
  throw input_error(name + " is " + to_string(mask.size()) + " pixels, expected " + to_string(images) +
                    " as the polarized images" +
                    (turned ? "; EXIF orientation is ignored: turn the pixels of the images or of the mask" : ""));
}

Mask undistorted_mask(const Mask& captured, const std::optional<LensCamera>& lens, const Context& context) {
  const ResamplingMap map(lens, identity_affine());
  if (map.is_identity()) return captured;
  Mask result(captured.size());
  parallel_pixels(context, captured.size(), [&](int u, int v) {
    const Eigen::Vector2d at = map(u, v);
    if (!(at.x() > -0.5 && at.y() > -0.5 && at.x() < captured.width() - 0.5 && at.y() < captured.height() - 0.5))
      return;
    result(u, v) = captured(static_cast<int>(std::lround(at.x())), static_cast<int>(std::lround(at.y())));
  });
  return result;
}

}  // namespace malus
