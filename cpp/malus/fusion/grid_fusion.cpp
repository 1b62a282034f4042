#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "malus/core/degrees_internal.h"
#include "malus/core/depth_normals_internal.h"
#include "malus/core/digits_internal.h"
#include "malus/core/fields.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_sums_internal.h"
#include "malus/fusion/grid_fusion_internal.h"
#include "malus/height/height_internal.h"

namespace malus {
namespace {

/// Values at the nodes of a grid over the image; node (i, j) lies at pixel (offset + i · pitch, offset + j · pitch).
class NodeGrid {
 public:
  NodeGrid(Size image, int pitch)
      : pitch_(pitch),
        offset_(std::min({pitch / 2, image.width - 1, image.height - 1})),
        values_({(image.width - 1 - offset_) / pitch + 1, (image.height - 1 - offset_) / pitch + 1}, 1, no_value) {}

  Image<float>& values() { return values_; }
  int pixel(int node) const { return offset_ + node * pitch_; }

  /// Nodes that at() reads for any finite pixel of a raster of the image's size.
  Mask nodes_under(const Image<float>& image, const Context& context) const {
    Mask nodes(values_.size());
    const auto mark = [&nodes](int i, int j) {  // rows of pixels share nodes
      std::atomic_ref(nodes(i, j)).store(1, std::memory_order_relaxed);
    };
    parallel_rows(context, image.height(), [&](int v) {
      const auto [j0, j1, t] = interval(v, values_.height());
      for (int u = 0; u < image.width(); ++u) {
        if (!std::isfinite(image(u, v))) continue;
        const auto [i0, i1, s] = interval(u, values_.width());
        mark(i0, j0), mark(i1, j0), mark(i0, j1), mark(i1, j1);
      }
    });
    return nodes;
  }

  /// Bilinear value at a pixel, constant beyond the outer nodes.
  double at(int u, int v) const {
    const auto [i0, i1, s] = interval(u, values_.width());
    const auto [j0, j1, t] = interval(v, values_.height());
    const double upper = (1 - s) * values_(i0, j0) + s * values_(i1, j0);
    const double lower = (1 - s) * values_(i0, j1) + s * values_(i1, j1);
    return (1 - t) * upper + t * lower;
  }

 private:
  struct Interval {
    int low, high;
    double share;
  };
  Interval interval(int pixel, int nodes) const {
    const double position =
        std::clamp(static_cast<double>(pixel - offset_) / pitch_, 0.0, static_cast<double>(nodes - 1));
    const int low = static_cast<int>(position);
    return {low, std::min(low + 1, nodes - 1), position - low};
  }

  int pitch_, offset_;
  Image<float> values_;
};

/// Gaussian mean along one axis of the finite nodes, as a weighted sum and its weight.
void blur_axis(const Context& context, const Image<double>& sum, const Image<double>& weight, double sigma,
               bool along_u, Image<double>& blurred_sum, Image<double>& blurred_weight) {
  const int reach = static_cast<int>(std::ceil(4 * sigma));
  std::vector<double> kernel;
  for (int k = -reach; k <= reach; ++k) kernel.push_back(sigma > 0 ? std::exp(-0.5 * k * k / (sigma * sigma)) : 1.0);
  parallel_pixels(context, sum.size(), [&](int u, int v) {
    double s = 0, w = 0;
    for (int k = -reach; k <= reach; ++k) {
      const int x = along_u ? u + k : u, y = along_u ? v : v + k;
      if (!sum.contains(x, y)) continue;
      s += kernel[static_cast<std::size_t>(k + reach)] * sum(x, y);
      w += kernel[static_cast<std::size_t>(k + reach)] * weight(x, y);
    }
    blurred_sum(u, v) = s;
    blurred_weight(u, v) = w;
  });
}

/// Gaussian mean over the finite nodes (Eq 15). Needed nodes without a finite node in reach take the mean of wider and
/// wider Gaussians, so that the transfer is defined wherever it is used.
void smooth_nodes(Image<float>& nodes, const Mask& needed, double sigma, const Context& context) {
  Image<double> sum(nodes.size()), weight(nodes.size());
  for (std::size_t i = 0; i < nodes.count(); ++i) {
    const bool known = std::isfinite(nodes[i]);
    sum[i] = known ? nodes[i] : 0;
    weight[i] = known ? 1 : 0;
  }
  std::vector<bool> done(nodes.count(), false);
  const double widest = std::max(sigma, 2.0 * std::max(nodes.width(), nodes.height()));
  for (double width = sigma; width <= widest; width = std::max(2 * width, 1.0)) {
    Image<double> s(nodes.size()), w(nodes.size()), s2(nodes.size()), w2(nodes.size());
    blur_axis(context, sum, weight, width, true, s, w);
    blur_axis(context, s, w, width, false, s2, w2);
    bool all = true;
    for (std::size_t i = 0; i < nodes.count(); ++i) {
      if (done[i]) continue;
      done[i] = w2[i] > 1e-3;
      all = all && (done[i] || needed[i] == 0);
      if (done[i]) nodes[i] = static_cast<float>(s2[i] / w2[i]);
    }
    if (all) return;
  }
}

/// A height with its parts (4-neighborhood) where they lie relative to each other in the prior; empty if it has only
/// one part. The equations give slopes, so each part has a free constant, and the Gaussian over the nodes would mix the
/// constants across the gaps between parts.
Image<float> with_parts_in_place(const Image<float>& height, const Image<float>& prior, const Context& context) {
  const OpenCvThreads opencv_threads(context.threads);
  Mask known(height.size());
  for (std::size_t i = 0; i < known.count(); ++i) known[i] = std::isfinite(height[i]) ? 255 : 0;
  cv::Mat numbers;  // of the parts, from 1 on; 0 where there is no height
  const int parts = cv::connectedComponents(as_mat(known), numbers, 4) - 1;
  if (parts < 2) return {};
  const int* const part_of = numbers.ptr<int>();

  struct Offset {
    double sum = 0, pixels = 0;
    double mean() const { return pixels > 0 ? sum / pixels : 0; }
  };
  std::vector<Offset> offsets(static_cast<std::size_t>(parts) + 1);
  for (std::size_t i = 0; i < height.count(); ++i) {
    const double offset = static_cast<double>(prior[i]) - height[i];
    if (!std::isfinite(offset)) continue;
    Offset& of_part = offsets[static_cast<std::size_t>(part_of[i])];
    of_part.sum += offset;
    of_part.pixels += 1;
  }
  // The largest part stays.
  const Offset largest = *std::max_element(offsets.begin(), offsets.end(),
                                           [](const Offset& a, const Offset& b) { return a.pixels < b.pixels; });
  Image<float> placed = height;
  parallel_pixels(context, height.size(), [&](int u, int v) {
    const std::size_t pixel = height.size().index(u, v);
    const Offset& offset = offsets[static_cast<std::size_t>(part_of[pixel])];
    if (offset.pixels > 0) placed[pixel] += static_cast<float>(offset.mean() - largest.mean());
  });
  return placed;
}

/// The error for a grid with no node where both surfaces have a height.
Error no_common_node(const Image<float>& polarization, const Image<float>& prior, int grid_px) {
  for (std::size_t i = 0; i < prior.count(); ++i) {
    if (std::isfinite(prior[i] - polarization[i]))
      return input_error("grid.grid_px = " + std::to_string(grid_px) +
                         ": no node of the grid lies on the object, expected a grid finer than the object");
  }
  return data_error("prior and polarization height share no node of the grid, expected surfaces that overlap");
}

/// Maps a surface to 0 … 1 by its own range, as printed in the paper.
struct UnitRange {
  double low = 0, span = 1;

  explicit UnitRange(const Image<float>& values) {
    double high = -std::numeric_limits<double>::infinity();
    low = std::numeric_limits<double>::infinity();
    for (const float value : values) {
      if (!std::isfinite(value)) continue;
      low = std::min<double>(low, value);
      high = std::max<double>(high, value);
    }
    span = high > low ? high - low : 1;
  }
  void to_unit(Image<float>& values) const {
    for (float& value : values) value = static_cast<float>((value - low) / span);
  }
};

/// The transfer on heights: the smoothed difference, and the smoothed square of what the smoothing removed from it.
struct Transfer {
  NodeGrid difference, disagreement;

  Transfer(const Image<float>& polarization, const Image<float>& prior, const GridFusionOptions& options,
           const Context& context)
      : difference(prior.size(), options.grid_px), disagreement(prior.size(), options.grid_px) {
    Image<float>& nodes = difference.values();
    bool any = false;
    for_each_pixel(nodes.size(), [&](int i, int j) {
      const int u = difference.pixel(i), v = difference.pixel(j);
      nodes(i, j) = prior(u, v) - polarization(u, v);
      any = any || std::isfinite(nodes(i, j));
    });
    if (!any) throw no_common_node(polarization, prior, options.grid_px);
    disagreement.values() = nodes;
    const Mask needed = difference.nodes_under(prior, context);
    smooth_nodes(nodes, needed, options.sigma_nodes, context);
    for (std::size_t k = 0; k < nodes.count(); ++k) {
      const float detail = disagreement.values()[k] - nodes[k];
      disagreement.values()[k] = detail * detail;
    }
    smooth_nodes(disagreement.values(), needed, options.sigma_nodes, context);
  }

  /// The fused height at a pixel from its polarization height and its prior height.
  float fused(int u, int v, float polarization, float prior) const {
    return std::isfinite(polarization) ? static_cast<float>(polarization + difference.at(u, v)) : prior;
  }
};

/// Throws a data error with the reason if no height was found.
void require_height(const HeightMap& height) {
  if (std::any_of(height.height.begin(), height.height.end(), [](float h) { return std::isfinite(h); })) return;
  throw data_error("grid fusion takes its detail from the height from polarization alone, and there is none (" +
                   std::string(enum_name(height.status)) + "); fusion = \"refined\" does not need it");
}

/// Warning for a height whose computation ended before it converged.
std::string caution_of_moving_height(const HeightMap& height) {
  std::ostringstream text;
  text.precision(2);
  text << "The height from polarization alone was still changing when its computation ended: its slopes by "
       << to_degrees(std::atan(height.last_update)) << "° in the last of " << height.iterations << " rounds. ";
  if (height.over_prior > most_over_prior) {
    text
        << "It is " << with_digits(height.over_prior, 2)
        << " times as high as the prior: do not rely on the surface's fine detail. The default fusion does not use it.";
  } else {
    text << "The surface's fine detail is less sure by about that; a larger height.iterations seldom helps.";
  }
  return text.str();
}

}  // namespace

FusedSurface fuse_grid(const HeightMap& height, const DepthPrior& prior, const GridFusionOptions& options,
                       const Context& context) {
  validate_fields(options, "grid");
  require_size(height.height, prior.depth.size(), "polarization height");
  require_size(prior.sigma, prior.depth.size(), "prior sigma");
  require_height(height);
  context.progress("fuse", 0.1, "grid transfer");
  const double focal = prior.camera.focal();
  Image<float> coarse = height_from_depth(prior.depth, prior.camera, height.perspective, context);
  Image<float> changed = with_parts_in_place(height.height, coarse, context);  // empty: the height is taken as it is
  double scale = 1;
  if (options.unit_scaling) {
    const UnitRange prior_range(coarse);
    scale = prior_range.span;
    prior_range.to_unit(coarse);
    if (changed.empty()) changed = height.height;
    UnitRange(changed).to_unit(changed);
  }
  const Image<float>& polarization = changed.empty() ? height.height : changed;
  const Transfer transfer(polarization, coarse, options, context);

  FusedSurface surface;
  surface.camera = prior.camera;
  surface.pose = prior.pose;
  surface.method = Fusion::grid;
  surface.status = FusionStatus::done;
  surface.confidence.limit(ConfidenceLevel::partial,
                           "The paper's grid transfer takes all detail from the polarization height; nothing checks "
                           "it against the prior.");
  if (height.status != HeightStatus::converged) surface.warnings.push_back(caution_of_moving_height(height));
  surface.depth = Image<float>::uninitialized(coarse.size());
  surface.sigma = Image<float>::uninitialized(coarse.size());
  const double mean_depth = height.perspective ? 0 : finite_mean(prior.depth, context);
  parallel_pixels(context, coarse.size(), [&](int u, int v) {
    const float before = coarse(u, v);
    surface.depth(u, v) = surface.sigma(u, v) = no_value;
    if (!std::isfinite(before)) return;
    const float after = transfer.fused(u, v, polarization(u, v), before);
    if (!std::isfinite(after)) return;
    // The change by the fusion, in GSD, is applied to the prior's own depth.
    const double change = (after - before) * scale;
    const double z = prior.depth(u, v);
    const double moved = height.perspective ? z * std::exp(-change / focal) : z - change * mean_depth / focal;
    const double gsd = z / focal;
    surface.depth(u, v) = static_cast<float>(moved);
    surface.sigma(u, v) = static_cast<float>(
        std::sqrt(prior.sigma(u, v) * prior.sigma(u, v) + gsd * gsd * scale * scale * transfer.disagreement.at(u, v)));
  });
  coarse = {};
  surface.normals = normals_from_depth(surface.depth, surface.camera, context);
  context.progress("fuse", 1.0);
  return surface;
}

}  // namespace malus
