#include <algorithm>
#include <array>
#include <cmath>

#include "malus/core/depth_normals_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/fusion/finished_surface_internal.h"
#include "malus/fusion/mirrored_light_internal.h"
#include "malus/fusion/reflection_labels_internal.h"
#include "malus/fusion/surface_sigma_internal.h"

namespace malus {
namespace {

/// Change from the prior's surface at the center of a pixel. On a diffuse body, whose polarization is weak and noisy,
/// it is the mean of the pixel's four nodes. Elsewhere the mean would smooth the detail, and cubics through the 4 × 4
/// nodes around the pixel are used.
double change_at(const RefinementField& field, int u, int v) {
  static constexpr std::array<double, 4> cubic{-1.0 / 16, 9.0 / 16, 9.0 / 16, -1.0 / 16};
  const auto change = [&](int i, int j) { return field.x(i, j) - field.x_prior(i, j); };
  const double mean = 0.25 * (change(u, v) + change(u + 1, v) + change(u, v + 1) + change(u + 1, v + 1));
  if (field.kind(u, v) == Reflection::diffuse && !field.reflection.mirrored) return mean;
  double sum = 0;
  for (int j = 0; j < 4; ++j) {
    for (int i = 0; i < 4; ++i) {
      if (!field.is_object(u + i - 1, v + j - 1)) return mean;
      sum += cubic[static_cast<std::size_t>(i)] * cubic[static_cast<std::size_t>(j)] * change(u + i - 1, v + j - 1);
    }
  }
  return sum;
}

/// Fills the rows of a strip in the surface and in the report's maps.
void fill_rows(const StripField& strip, RowRange rows, const DepthPrior& prior, const Image<float>& sigma,
               const Refinement& refinement, FusedSurface& surface) {
  const RefinementImage& image = refinement.image;
  RefineReport& report = refinement.report;
  const Size size = image.camera.size;
  const Image<float> mirrored = mirrored_light(strip.field, refinement.context);
  parallel_rows(refinement.context, std::min(rows.end, size.height) - rows.begin, [&](int row) {
    const int v = rows.begin + row, strip_v = v - strip.first_row;
    for (int u = 0; u < size.width; ++u) {
      if (!image.pixels(u, v)) continue;
      surface.depth(u, v) =
          static_cast<float>(prior.depth(u, v) * std::exp(change_at(strip.field, u, strip_v) / image.camera.focal()));
      // Systematic errors of the prior do not average out: sigma must not fall below them.
      const bool is_noise = prior.noise > 0 || prior.sigma.empty();
      surface.sigma(u, v) = is_noise ? sigma(u, strip_v) : std::max(sigma(u, strip_v), prior.sigma(u, v));
      report.mirrored(u, v) = mirrored(u, strip_v);
      report.label(u, v) = static_cast<std::uint8_t>(image.kind(u, v));
      report.confidence(u, v) = static_cast<std::uint8_t>(std::lround(255 * stokes_weight(strip.field, u, strip_v)));
    }
  });
}

}  // namespace

FusedSurface finish_surface(const DepthPrior& prior, Refinement& refinement) {
  constexpr int margin = surface_sigma_reach_px + weights_reach_px;
  static_assert(mirrored_light_reach_px <= surface_sigma_reach_px);
  RefinementImage& image = refinement.image;
  RefineReport& report = refinement.report;
  const Context& context = refinement.context;
  const Size size = image.camera.size;
  FusedSurface surface;
  surface.camera = prior.camera;
  surface.pose = prior.pose;
  surface.method = Fusion::refined;
  surface.depth = surface.sigma = Image<float>(size, 1, no_value);
  report.specular_share = specular_share(image);
  report.metal = looks_like_metal(image);
  report.label = report.confidence = Image<std::uint8_t>(size);
  report.mirrored = Image<float>(size, 1, no_value);
  ResidualSummary summary(image.usable);
  PriorErrors errors{prior.smoothing_px, prior.shares_windows};
  if (prior.noise > 0) errors.noise_gsd = prior.noise * image.camera.focal() / image.depth_of(0);
  for (const TileStrip& tiles : refinement.strips) {
    const StripField strip = refinement.weighted_strip(tiles.rows, margin, refinement.weights(1, true), &summary);
    const Size part = strip.field.size();
    // Without `evidence` there is no trust map: all of the result is the refined surface.
    const Image<std::uint8_t> trust =
        report.trust.empty() ? Image<std::uint8_t>(part, 1, 255)
                             : cropped(report.trust, {0, strip.first_row, part.width, strip.first_row + part.height});
    fill_rows(strip, tiles.rows, prior, surface_sigma(strip.field, trust, errors, context), refinement, surface);
  }
  image.x = {};  // frees as much memory as the normals take
  report.trust = cropped(report.trust, {0, 0, size.width, size.height});
  surface.normals = normals_from_depth(surface.depth, surface.camera, context);
  report.tiles = static_cast<int>(refinement.tiles.size());
  report.median_residual = summary.quality().median_residual;
  return surface;
}

}  // namespace malus
