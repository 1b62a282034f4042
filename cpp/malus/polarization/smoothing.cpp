#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <optional>
#include <utility>

#include "malus/core/masked_blur_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/polarization/smoothing_internal.h"

namespace malus {
namespace {

constexpr double mean_px = 0.8, variance_px = 3;
/// Share of the variance of independent errors that is in the difference from the mean over the neighbors.
constexpr float difference_share = 0.63F;
/// The least detail that is assumed, in units of the noise's variance, so that a small excess of residuals, which may
/// be chance, has a small effect.
constexpr float least_detail = 0.1F;

/// Rows that are smoothed at once, so that a large image needs little memory beside it.
constexpr int strip_rows = 256;
/// How many rows away a pixel still counts: the reach of both Gaussians, three standard deviations each, rounded up.
constexpr int reach_px = 3 + 9;
static_assert(3 * mean_px <= 3 && 3 * variance_px <= 9);

/// Rows [begin, end) are smoothed; they depend on rows [first, last).
struct Strip {
  int begin, end, first, last;
};

Strip strip_from(int begin, int height) {
  const int end = std::min(begin + strip_rows, height);
  return {begin, end, std::max(begin - reach_px, 0), std::min(end + reach_px, height)};
}

/// What is known of the polarization of each pixel.
struct LinearPart {
  Mask valid;
  std::array<Image<float>, 2> values;  ///< (s1, s2) / s0
  Image<float> noise;                  ///< variance of both together by the noise model …
  Image<float> errors;                 ///< … and times the squared residual
};

LinearPart linear_part(const PolarizationState& state, const Strip& strip, const Context& context) {
  const Size size{state.size().width, strip.last - strip.first};
  LinearPart part{Mask(size), {Image<float>(size), Image<float>(size)}, Image<float>(size), Image<float>(size)};
  const StokesVariances variances(state);
  parallel_pixels(context, size, [&](int u, int row) {
    const int v = strip.first + row;
    if (!state.is_valid(u, v)) return;
    const Eigen::Vector3d stokes = state.stokes(u, v);
    part.valid(u, row) = 255;
    part.values[0](u, row) = static_cast<float>(stokes[1] / stokes[0]);
    part.values[1](u, row) = static_cast<float>(stokes[2] / stokes[0]);
    const float residual = std::min(state.residual(u, v), largest_typical_residual);
    part.noise(u, row) = static_cast<float>(2 * variances(u, v, stokes).linear / (stokes[0] * stokes[0]));
    part.errors(u, row) = residual * residual * part.noise(u, row);
  });
  return part;
}

/// Rows of degree and phase, smoothed.
struct SmoothRows {
  int begin;
  Image<float> rho, phi;
};

void copy_rows(const Image<float>& from, int first, Image<float>& to, int begin, int rows) {
  std::copy_n(from.row(first), static_cast<std::ptrdiff_t>(rows) * from.width(), to.row(begin));
}

SmoothRows smoothed(const PolarizationState& state, const Strip& strip, LinearPart part, const Context& context) {
  const auto mean = [&](const Image<float>& values, double sigma_px) {
    return masked_blur(values, part.valid, sigma_px, context);
  };
  const std::array<Image<float>, 2> around{mean(part.values[0], mean_px), mean(part.values[1], mean_px)};
  Image<float> differences(part.valid.size());
  parallel_pixels(context, part.valid, [&](int u, int row) {
    const float d1 = part.values[0](u, row) - around[0](u, row), d2 = part.values[1](u, row) - around[1](u, row);
    differences(u, row) = d1 * d1 + d2 * d2;
  });
  part.noise = mean(part.noise, variance_px);
  part.errors = mean(part.errors, variance_px);
  differences = mean(differences, variance_px);
  const Size size{state.size().width, strip.end - strip.begin};
  SmoothRows result{strip.begin, Image<float>::uninitialized(size), Image<float>::uninitialized(size)};
  copy_rows(state.rho, strip.begin, result.rho, 0, size.height);
  copy_rows(state.phi, strip.begin, result.phi, 0, size.height);
  parallel_pixels(context, size, [&](int u, int v) {
    const int row = strip.begin - strip.first + v;
    if (part.valid(u, row) == 0) return;
    const float noise = part.noise(u, row), errors = part.errors(u, row), texture = errors - noise;
    if (!(texture > 0)) return;
    const float detail = std::max(differences(u, row) - difference_share * errors, 0.0F) + least_detail * noise;
    const float share = texture / (texture + detail);
    const auto moved = [&](std::size_t c) {
      const float value = part.values[c](u, row);
      return value + share * (around[c](u, row) - value);
    };
    const float s1 = moved(0), s2 = moved(1);
    result.rho(u, v) = std::min(std::hypot(s1, s2), 1.0F);
    result.phi(u, v) = phase_of(s1, s2);
  });
  return result;
}

void write(const SmoothRows& rows, PolarizationState& state) {
  copy_rows(rows.rho, 0, state.rho, rows.begin, rows.rho.height());
  copy_rows(rows.phi, 0, state.phi, rows.begin, rows.phi.height());
}

}  // namespace

void smooth_polarization(PolarizationState& state, const Context& context) {
  // A strip is written after the next one is read, which depends on its last rows as they were.
  std::optional<SmoothRows> previous;
  const int height = state.size().height;
  for (int begin = 0; begin < height; begin += strip_rows) {
    const Strip strip = strip_from(begin, height);
    LinearPart part = linear_part(state, strip, context);
    if (previous) write(*previous, state);
    previous = smoothed(state, strip, std::move(part), context);
  }
  if (previous) write(*previous, state);
}

}  // namespace malus
