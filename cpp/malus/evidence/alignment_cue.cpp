#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "malus/core/pixel_rect_internal.h"
#include "malus/evidence/alignment_cue_internal.h"
#include "malus/evidence/smoothing_internal.h"
#include "malus/polarization/phase_weight_internal.h"
#include "malus/polarization/ray_frame.h"

namespace malus {
namespace {

/// Band of scales that is compared: finer scales are noise, coarser ones are changes of the light from place to place.
constexpr double fine_px = 0.8, coarse_px = 6;
constexpr float gradient_floor = 0.005F, bend_floor = 0.01F;
/// A prior has relief if the logarithms of its bends spread by this much. Clouds and scans have .15 to .6. A sphere has
/// .04, only from its rim, whose place is that of the mask's outline and not the sphere's.
constexpr double least_relief = 0.08;
/// A prior has colors if the logarithms of their brightness spread by this much: rounding spreads those of a single
/// color by 1e-6, and a step of one channel of 8 bits is 1e-3.
constexpr double least_contrast = 1e-4;

template <class T>
std::vector<T> inside(const Image<T>& image, const Mask& pixels) {
  std::vector<T> values;
  for (std::size_t i = 0; i < pixels.count(); ++i)
    if (pixels[i] != 0) values.push_back(image[i]);
  return values;
}

std::vector<AlignmentCue::Value> real_values(const Image<float>& image, const Mask& pixels) {
  const std::vector<float> values = inside(image, pixels);
  return {values.begin(), values.end()};
}

/// A mask as weights of 0 and 1.
Image<float> ones(const Mask& mask) {
  Image<float> weights(mask.size());
  for (std::size_t i = 0; i < mask.count(); ++i) weights[i] = mask[i] != 0 ? 1.0F : 0.0F;
  return weights;
}

double deviation(const std::vector<AlignmentCue::Value>& values) {
  double sum = 0, squares = 0;
  for (const AlignmentCue::Value& value : values) {
    sum += value.real();
    squares += value.real() * value.real();
  }
  const auto n = static_cast<double>(std::max<std::size_t>(values.size(), 1));
  return std::sqrt(std::max(squares / n - sum * sum / (n * n), 0.0));
}

/// ln (|gradient| + floor) of channels, with the gradients of all channels combined; pixels next to one outside the
/// mask are removed from the mask.
Image<float> log_gradient(const Image<float>& image, Mask& mask, float floor) {
  Image<float> result(image.size());
  Mask inner(mask.size());
  for_each_pixel(PixelRect{1, 1, image.width() - 1, image.height() - 1}, mask, [&](int u, int v) {
    if (!(mask(u - 1, v) && mask(u + 1, v) && mask(u, v - 1) && mask(u, v + 1))) return;
    float squares = 0;
    for (int c = 0; c < image.channels(); ++c) {
      const float x = image(u + 1, v, c) - image(u - 1, v, c), y = image(u, v + 1, c) - image(u, v - 1, c);
      squares += 0.25F * (x * x + y * y);
    }
    if (!std::isfinite(squares)) return;
    inner(u, v) = 255;
    result(u, v) = std::log(std::sqrt(squares) + floor);
  });
  mask = std::move(inner);
  return result;
}

}  // namespace

TemplatePixels template_pixels(const Mask& pixels) {
  TemplatePixels result;
  for_each_pixel(pixels, [&](int u, int v) {
    result.u.push_back(static_cast<float>(u));
    result.v.push_back(static_cast<float>(v));
  });
  if (result.count() == 0) return result;
  std::vector<float> sorted_u = result.u, sorted_v = result.v;
  std::ranges::sort(sorted_u);
  std::ranges::sort(sorted_v);
  const auto extent = [n = result.count()](const std::vector<float>& x) {
    return x[n * 98 / 100] - x[n * 2 / 100] + 1;
  };
  result.extent = std::max(extent(sorted_u), extent(sorted_v));
  const auto n = static_cast<double>(result.count());
  for (std::size_t i = 0; i < result.count(); ++i) {
    result.center_u += result.u[i] / n;
    result.center_v += result.v[i] / n;
  }
  double squares = 0;
  constexpr int side = 10;
  const float width = sorted_u.back() - sorted_u.front() + 1, height = sorted_v.back() - sorted_v.front() + 1;
  for (std::size_t i = 0; i < result.count(); ++i) {
    squares += std::pow(result.u[i] - result.center_u, 2) + std::pow(result.v[i] - result.center_v, 2);
    const auto column = static_cast<int>(side * (result.u[i] - sorted_u.front()) / width);
    const auto row = static_cast<int>(side * (result.v[i] - sorted_v.front()) / height);
    result.block.push_back(static_cast<std::uint16_t>(row * side + column));
  }
  result.radius = std::sqrt(squares / n);
  return result;
}

/// The image's values where the template's pixels lie, and the common weights.
struct AlignmentCue::Samples {
  std::vector<Value> image;
  std::vector<float> weights;
  Value turn;
};

/// Weighted sums over the template's pixels, of values minus their means.
struct AlignmentCue::Moments {
  Value mean_template, mean_image;
  double var_template = 0, var_image = 0;
  std::complex<double> covariance;
};

AlignmentCue::AlignmentCue(std::vector<Value> values, std::vector<float> weights, const Image<float>& image_real,
                           const Image<float>& image_imaginary, const Image<float>& image_weights, int turns)
    : values_(std::move(values)), weights_(std::move(weights)), image_(image_real.size(), 3), turns_(turns) {
  for (std::size_t i = 0; i < image_real.count(); ++i) {
    image_[3 * i] = image_real[i];
    image_[3 * i + 1] = image_imaginary.empty() ? 0.0F : image_imaginary[i];
    image_[3 * i + 2] = image_weights[i];
  }
}

AlignmentCue::Value AlignmentCue::turn_of(const Similarity& moved) const {
  return std::polar(1.0F, static_cast<float>(-turns_ * moved.turn_rad));
}

template <bool real, class Take>
void AlignmentCue::for_each_sample(const TemplatePixels& pixels, const Similarity& moved, Take&& take) const {
  const double scale = std::exp(moved.log_scale);
  const auto cosine = static_cast<float>(scale * std::cos(moved.turn_rad)),
             sine = static_cast<float>(scale * std::sin(moved.turn_rad));
  const auto center_u = static_cast<float>(pixels.center_u), center_v = static_cast<float>(pixels.center_v);
  const float to_u = center_u + static_cast<float>(moved.du), to_v = center_v + static_cast<float>(moved.dv);
  const auto last_u = static_cast<float>(image_.width() - 1), last_v = static_cast<float>(image_.height() - 1);
  for (std::size_t i = 0; i < pixels.count(); ++i) {
    const float x = pixels.u[i] - center_u, y = pixels.v[i] - center_v;
    const float u = cosine * x - sine * y + to_u, v = sine * x + cosine * y + to_v;
    if (!(u >= 0 && v >= 0 && u < last_u && v < last_v)) continue;
    const int u0 = static_cast<int>(u), v0 = static_cast<int>(v);
    const float fu = u - static_cast<float>(u0), fv = v - static_cast<float>(v0);
    const float* const above = image_.row(v0) + 3 * u0;
    const float* const below = image_.row(v0 + 1) + 3 * u0;
    const auto value = [&](int c) {
      return (1 - fv) * ((1 - fu) * above[c] + fu * above[c + 3]) + fv * ((1 - fu) * below[c] + fu * below[c + 3]);
    };
    const float weight = value(2);
    if (!(weight > 1e-4F)) continue;
    take(i, value(0) / weight, real ? 0.0F : value(1) / weight, weights_[i] * weight);
  }
}

AlignmentCue::Samples AlignmentCue::sample(const TemplatePixels& pixels, const Similarity& moved) const {
  Samples samples{std::vector<Value>(pixels.count()), std::vector<float>(pixels.count()), turn_of(moved)};
  for_each_sample<false>(pixels, moved, [&](std::size_t i, float f_real, float f_imaginary, float w) {
    samples.image[i] = {f_real, f_imaginary};
    samples.weights[i] = w;
  });
  return samples;
}

/// The search calls this for thousands of places. It is therefore written without complex products, which check for
/// NaN, and real values (`real`) are summed without their imaginary parts, which are zero.
template <bool real>
AlignmentCue::Moments AlignmentCue::summed(const TemplatePixels& pixels, const Similarity& moved) const {
  const Value turn = turn_of(moved);
  double weight = 0, squares_template = 0, squares_image = 0;
  double t_real = 0, t_imaginary = 0, f_real = 0, f_imaginary = 0, product_real = 0, product_imaginary = 0;
  for_each_sample<real>(
      pixels, moved, [&](std::size_t i, float image_real, float image_imaginary, float sample_weight) {
        const double w = sample_weight, fr = image_real, fi = image_imaginary;
        const Value& value = values_[i];
        const double tr = real ? value.real() : value.real() * turn.real() - value.imag() * turn.imag();
        const double ti = real ? 0 : value.real() * turn.imag() + value.imag() * turn.real();
        weight += w;
        t_real += w * tr;
        f_real += w * fr;
        squares_template += w * (tr * tr + ti * ti);
        squares_image += w * (fr * fr + fi * fi);
        product_real += w * fr * tr + w * fi * ti;
        if (real) return;
        t_imaginary += w * ti;
        f_imaginary += w * fi;
        product_imaginary += w * fi * tr - w * fr * ti;
      });
  if (!(weight > 0)) return {};
  const std::complex<double> mean_template(t_real / weight, t_imaginary / weight);
  const std::complex<double> mean_image(f_real / weight, f_imaginary / weight);
  const std::complex<double> product(product_real, product_imaginary);
  return {Value(mean_template), Value(mean_image), squares_template - weight * std::norm(mean_template),
          squares_image - weight * std::norm(mean_image), product - weight * mean_image * std::conj(mean_template)};
}

AlignmentCue::Moments AlignmentCue::moments(const TemplatePixels& pixels, const Similarity& moved) const {
  if (turns_ != 0) return summed<false>(pixels, moved);
  Moments moments = summed<true>(pixels, moved);
  // Real values that correlate with the wrong sign count as uncorrelated.
  if (moments.covariance.real() < 0) moments.covariance = 0;
  return moments;
}

double AlignmentCue::correlation2(const TemplatePixels& pixels, const Similarity& moved) const {
  const Moments m = moments(pixels, moved);
  const double product = m.var_template * m.var_image;
  return product > 0 ? std::norm(m.covariance) / product : 0;
}

double AlignmentCue::contrast(const TemplatePixels& pixels, const Similarity& moved) const {
  const Moments m = moments(pixels, moved);
  return m.var_template > 0 ? std::sqrt(m.var_image / m.var_template) : 0;
}

/// Σ w (|f|² − |f − a t|²) of each block over Σ w |f|² of all; the sum over the blocks is the squared correlation.
std::vector<double> AlignmentCue::explained_by_block(const TemplatePixels& pixels, const Similarity& at) const {
  const Samples samples = sample(pixels, at);
  const Moments m = moments(pixels, at);
  std::vector<double> blocks(TemplatePixels::blocks, 0.0);
  if (!(m.var_template > 0 && m.var_image > 0)) return blocks;
  const Value amplitude(m.covariance / m.var_template);
  for (std::size_t i = 0; i < values_.size(); ++i) {
    const Value f = samples.image[i] - m.mean_image, t = values_[i] * samples.turn - m.mean_template;
    blocks[pixels.block[i]] += samples.weights[i] * (std::norm(f) - std::norm(f - amplitude * t)) / m.var_image;
  }
  return blocks;
}

double sum_in_sigmas(const std::vector<double>& parts) {
  double sum = 0, squares = 0;
  for (const double part : parts) {
    sum += part;
    squares += part * part;
  }
  return squares > 0 ? sum / std::sqrt(squares) : 0;
}

std::vector<double> AlignmentCue::gain_by_block(const TemplatePixels& pixels, const Similarity& from,
                                                const Similarity& to) const {
  std::vector<double> gained = explained_by_block(pixels, to);
  const std::vector<double> before = explained_by_block(pixels, from);
  for (std::size_t b = 0; b < gained.size(); ++b) gained[b] -= before[b];
  return gained;
}

double AlignmentCue::signal_sigmas(const TemplatePixels& pixels, const Similarity& at) const {
  return sum_in_sigmas(explained_by_block(pixels, at));
}

double AlignmentCue::independent_pixels(const TemplatePixels& pixels, const Similarity& at) const {
  const Samples samples = sample(pixels, at);
  const Moments m = moments(pixels, at);
  if (!(m.var_template > 0)) return 1;
  const Value amplitude(m.covariance / m.var_template);
  std::array<std::complex<double>, TemplatePixels::blocks> products{};
  double left = 0;
  for (std::size_t i = 0; i < values_.size(); ++i) {
    const Value f = samples.image[i] - m.mean_image, t = values_[i] * samples.turn - m.mean_template;
    const Value rest = f - amplitude * t;
    left += samples.weights[i] * std::norm(rest);
    products[pixels.block[i]] += std::complex<double>(samples.weights[i] * rest * std::conj(t));
  }
  double scatter = 0;
  for (const std::complex<double>& product : products)
    scatter += turns_ == 0 ? product.real() * product.real() : 0.5 * std::norm(product);
  return scatter > 0 ? std::clamp(m.var_template * left / scatter, 1.0, static_cast<double>(pixels.count())) : 1;
}

std::optional<AlignmentCue> color_cue(const PriorView& prior, const SceneView& scene, const Mask& pixels) {
  if (prior.brightness.empty()) return std::nullopt;
  std::vector<AlignmentCue::Value> colors =
      real_values(band_inside(prior.brightness, pixels, fine_px, coarse_px), pixels);
  if (deviation(colors) < least_contrast) return std::nullopt;
  return AlignmentCue(std::move(colors), inside(ones(pixels), pixels),
                      band_inside(scene.brightness, scene.seen, fine_px, coarse_px), {}, ones(scene.seen), 0);
}

AlignmentCue phase_cue(const PriorView& prior, const SceneView& scene, const Mask& pixels) {
  std::vector<AlignmentCue::Value> azimuths;
  std::vector<float> weights;
  for_each_pixel(pixels, [&](int u, int v) {
    const Eigen::Vector3d normal(prior.normals(u, v, 0), prior.normals(u, v, 1), prior.normals(u, v, 2));
    const RayFrame frame = ray_frame(scene.camera.ray(u, v));
    const Slopes slopes = frame.slopes(normal);
    const bool known = normal.dot(frame.view) > 0.1 && slopes.tan2() > 1e-6;
    azimuths.push_back(known ? std::polar(1.0F, static_cast<float>(4 * slopes.azimuth_rad())) : 0.0F);
    weights.push_back(known ? static_cast<float>(angle_weight(azimuth_variance(slopes.tan2()))) : 0.0F);
  });
  Image<float> real(scene.size()), imaginary(scene.size()), phase_weights(scene.size());
  for (std::size_t i = 0; i < real.count(); ++i) {
    const std::complex<double> polarization(scene.s1[i], scene.s2[i]);
    const double degree2 = std::norm(polarization);
    if (!(degree2 > 0)) continue;
    phase_weights[i] = static_cast<float>(angle_weight(phase_variance(scene.variance[i], degree2)));
    const std::complex<double> twice = polarization * polarization / degree2;
    real[i] = phase_weights[i] * static_cast<float>(twice.real());
    imaginary[i] = phase_weights[i] * static_cast<float>(twice.imag());
  }
  for (Image<float>* image : {&real, &imaginary, &phase_weights}) smooth(*image, fine_px);
  return {std::move(azimuths), std::move(weights), real, imaginary, phase_weights, 4};
}

std::optional<AlignmentCue> edge_cue(const PriorView& prior, const SceneView& scene, const Mask& pixels) {
  Mask bent = pixels;
  const Image<float> bends = log_gradient(prior.normals, bent, bend_floor);
  std::vector<AlignmentCue::Value> relief = real_values(band_inside(bends, bent, fine_px, coarse_px), pixels);
  if (deviation(relief) < least_relief) return std::nullopt;
  Image<float> brightness = scene.brightness;
  for (float& value : brightness) value = std::isfinite(value) ? value : 0.0F;
  smooth(brightness, fine_px);
  Mask seen = scene.seen;
  const Image<float> changes = log_gradient(brightness, seen, gradient_floor);
  return AlignmentCue(std::move(relief), inside(ones(bent), pixels), band_inside(changes, seen, fine_px, coarse_px), {},
                      ones(seen), 0);
}

}  // namespace malus
