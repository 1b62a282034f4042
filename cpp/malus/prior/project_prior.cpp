#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <limits>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <span>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "malus/core/cell_values_internal.h"
#include "malus/core/digits_internal.h"
#include "malus/core/error.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/core/tiled_axis_internal.h"
#include "malus/prior/choose_smoothing_internal.h"
#include "malus/prior/project_prior_internal.h"
#include "malus/prior/rasterize_mesh_internal.h"
#include "malus/prior/rounded_points_internal.h"
#include "malus/prior/shape_depth_internal.h"
#include "malus/prior/smoothing_spline_internal.h"
#include "malus/prior/visible_points_internal.h"

namespace malus {
namespace {

/// If more than this share of a cloud's points on the object faces away, the error message names the normals as the
/// cause.
constexpr double mostly = 0.7;
constexpr const char* normals_inwards =
    "the cloud's normals point away from the camera: turn them outwards, or export the cloud without them";

void validate(const Pinhole& camera, const Pose& pose, const Mask& mask, const PriorOptions& options) {
  validate_fields(options, "prior");
  require_size(mask, camera.size, "mask");
  if (!pose.rotation.allFinite() || !pose.translation.allFinite()) {
    throw input_error("prior: the camera's pose is not finite");
  }
  if (count_of_set(mask) == 0) {
    throw input_error("mask: no pixel is set, expected the object's pixels to be non-zero");
  }
}

void require_points(const VisiblePoints& visible, const PriorOptions& options) {
  const PointCensus& census = visible.census;
  if (census.reversed) {
    throw data_error("prior cloud: " + std::to_string(census.facing_away) + " of " + std::to_string(census.total) +
                     " points face away, but lie in front of those that face the camera: " + normals_inwards);
  }
  if (visible.points.size() >= static_cast<std::size_t>(options.min_points)) return;
  std::ostringstream message;
  message << "prior cloud: " << census.used << " of " << census.total << " points are visible on the object";
  if (census.used > visible.points.size())
    message << ", in only " << visible.points.size() << " different places of the image";
  message << ", expected at least " << options.min_points << " (" << census.behind << " behind the camera, "
          << census.outside << " outside the image, " << census.off_object << " outside the mask, "
          << census.facing_away << " facing away, " << census.hidden << " hidden, " << census.outliers
          << " outliers): ";
  const std::size_t on_object = census.facing_away + census.hidden + census.outliers + census.used;
  if (static_cast<double>(census.facing_away) > mostly * static_cast<double>(on_object)) {
    message << normals_inwards;
  } else if (2 * census.used > census.total) {
    message << "the cloud has too few points";
  } else {
    message << "check that cloud and camera pose are in one frame and unit";
  }
  throw data_error(message.str());
}

/// Warns if much of the object has only points that face away: programs that orient normals may fail on single patches.
void warn_of_turned_patches(const PointCensus& census, const Context& context) {
  // Right clouds of rendered stations have 0.002 at most, also that of a figurine, a third of whose points face away.
  constexpr double much = 0.1;
  if (census.away_only <= much) return;
  context.log(LogLevel::warning,
              "prior cloud: on " + percent(census.away_only) +
                  " of the places where it has points all their normals point away from the camera, so that none of "
                  "these points is used: orient the normals or export the cloud without them, unless it shows only the "
                  "object's back there");
}

/// Subtracts a surface's height and slope from a point.
void lower(ViewPoint& point, double height, const Eigen::Vector2d& slope) {
  point.height -= static_cast<float>(height);
  point.slope_u -= static_cast<float>(slope.x());
  point.slope_v -= static_cast<float>(slope.y());
}

/// Plane in (u, v) that most points follow, by reweighted least squares; the spline models the points' heights above
/// it. For a dense cloud every k-th point suffices: the points are in row order, so these are evenly spread.
class ReferencePlane {
 public:
  explicit ReferencePlane(std::span<const ViewPoint> points) {
    constexpr std::size_t most = 50'000;
    const std::size_t stride = points.size() / most + 1, count = (points.size() + stride - 1) / stride;
    std::vector<double> weights(count, 1.0), residuals(count);
    for (int round = 0; round < 8; ++round) {
      Eigen::Matrix3d normal = 1e-9 * Eigen::Matrix3d::Identity();
      Eigen::Vector3d right = Eigen::Vector3d::Zero();
      for (std::size_t i = 0; i < count; ++i) {
        const ViewPoint& point = points[i * stride];
        const Eigen::Vector3d row(1, point.u, point.v);
        normal += weights[i] * row * row.transpose();
        right += weights[i] * point.height * row;
      }
      plane_ = normal.ldlt().solve(right);
      const auto residual = [&](std::size_t i) {
        const ViewPoint& point = points[i * stride];
        return point.height - at(point.u, point.v);
      };
      for (std::size_t i = 0; i < count; ++i) residuals[i] = std::abs(residual(i));
      const double spread = robust_spread(residuals);
      if (!(spread > 0)) break;  // most points lie exactly in the plane, as those of a plane parallel to the sensor
      for (std::size_t i = 0; i < count; ++i) {
        const double r = residual(i) / (2 * spread);
        weights[i] = 1 / (1 + r * r);
      }
    }
  }
  double at(double u, double v) const { return plane_[0] + plane_[1] * u + plane_[2] * v; }
  Eigen::Vector2d slope() const { return plane_.tail<2>(); }

 private:
  Eigen::Vector3d plane_;
};

/// Distance of each pixel from the nearest point, in px.
cv::Mat distance_from_points(Size size, std::span<const ViewPoint> points) {
  Mask free(size, 1, 1);
  for (const ViewPoint& p : points) free(pixel_of(p.u, size.width), pixel_of(p.v, size.height)) = 0;
  cv::Mat distance;
  cv::distanceTransform(as_mat(free), distance, cv::DIST_L2, cv::DIST_MASK_5);
  return distance;
}

/// Share of object pixels farther than `distance_px` from every point.
double far_fraction(const Mask& mask, const cv::Mat& from_points, double distance_px) {
  return mean_over(mask, [&](int u, int v) { return from_points.at<float>(v, u) > distance_px ? 1.0 : 0.0; });
}

struct Surface {
  Image<float> height;    ///< relative to the reference plane, in GSD; only inside the mask
  Image<float> variance;  ///< of the height, for unit noise
  double noise = 0;       ///< standard deviation of a point
};

/// How the cloud is smoothed.
struct Smoothing {
  SmoothingStrength strength;
  double length_px = 0, cell_px = 0, tension_px = 0, edge_tolerance = 0;
  bool keep_raised = false;
};

/// Mean square of a standard normal variable under the weights of SmoothingSpline::reweight(1).
constexpr double weighted_gaussian_variance = 0.5808;

struct SplineFit {
  SmoothingSpline spline;
  Image<float> variance;  ///< for unit noise, per cell
  double noise2;          ///< variance of a point
};

/// Robust smoothing of the points in a box.
SplineFit fit_robust(const Mask& mask, PixelRect box, const Smoothing& how, std::span<const ViewPoint> points,
                     int samples, const Context& context) {
  // The weights of clustered outliers fall slowly: repeat until the weights no longer change.
  constexpr int max_rounds = 8;
  constexpr double settled = 0.004;
  SmoothingSpline spline(mask, box, how.cell_px, how.tension_px, points, context);
  for (int round = 0; round < max_rounds; ++round) {
    spline.solve(how.strength.lambda, how.strength.kappa);
    Residuals residuals;
    spline.append_residuals(residuals);
    if (!spline.reweight(robust_spread(residuals, context), settled, how.keep_raised)) break;
    spline.soften_edges(how.edge_tolerance);
    if (round + 1 == max_rounds) spline.solve(how.strength.lambda, how.strength.kappa);
  }
  const double data = spline.weight_sum() + 2 * spline.slope_weight_sum();
  const double noise2 = spline.penalized_residual() / std::max(data - 3, 1.0) / weighted_gaussian_variance;
  Image<float> variance = spline.variance(samples, context.seed);
  return {std::move(spline), std::move(variance), std::max(noise2, 0.0)};
}

/// Adds weight(u, v) times the spline and its variance for unit noise to a surface.
template <class Weight>
void add_to(Surface& surface, const SplineFit& fit, const Mask& mask, const Context& context, Weight&& weight) {
  const PixelRect& box = fit.spline.box();
  const Image<float>& variance = fit.variance;
  parallel_rows(context, box.height(), [&](int row) {
    const int v = box.v0 + row;
    std::vector<float> heights(static_cast<std::size_t>(box.width()));
    fit.spline.evaluate_row(v, heights.data());
    const int cell_row = std::min(static_cast<int>((row + 0.5) / fit.spline.cell_px()), variance.height() - 1);
    for (int u = box.u0; u < box.u1; ++u) {
      if (mask(u, v) == 0) continue;
      const int column = std::min(static_cast<int>((u - box.u0 + 0.5) / fit.spline.cell_px()), variance.width() - 1);
      const float share = static_cast<float>(weight(u, v));
      surface.height(u, v) += share * heights[static_cast<std::size_t>(u - box.u0)];
      surface.variance(u, v) += share * variance(column, cell_row);
    }
  });
}

/// Surface through all points: one system, or, above max_unknowns, a coarse spline of the whole surface and overlapping
/// tiles for the difference from it.
Surface smooth_cloud(LargeVector<ViewPoint> points, const Mask& mask, const Smoothing& how, const PriorOptions& options,
                     const Context& context) {
  const PixelRect box = bounding_box(mask);
  Surface surface{Image<float>(mask.size(), 1, 0.0F), Image<float>(mask.size(), 1, 0.0F), 0};
  const double unknowns = static_cast<double>(box.width()) * box.height() / (how.cell_px * how.cell_px);
  if (unknowns <= options.max_unknowns) {
    const SplineFit whole = fit_robust(mask, box, how, points, options.sigma_samples, context);
    add_to(surface, whole, mask, context, [](int, int) { return 1.0; });
    surface.noise = std::sqrt(whole.noise2);
    return surface;
  }

  // The coarse spline is much smoother than the tiles, so that nearly all bending of the surface is in the tiles.
  Smoothing coarse = how;
  const double widening = std::max(4.0, std::sqrt(unknowns / options.max_unknowns));
  coarse.strength.lambda *= widening * widening;
  coarse.length_px *= widening;
  coarse.cell_px *= widening;
  {
    const SplineFit whole = fit_robust(mask, box, coarse, points, 0, context);
    for (ViewPoint& p : points) {
      const Eigen::Vector2d slope = whole.spline.evaluate_slope(p.u, p.v);
      lower(p, whole.spline.evaluate(p.u, p.v), slope);
    }
    parallel_rows(context, box.height(),
                  [&](int row) { whole.spline.evaluate_row(box.v0 + row, surface.height.row(box.v0 + row) + box.u0); });
  }
  // Far from points the tiles level out to the coarse surface, which all tiles share, so there are no seams.
  const int margin = static_cast<int>(std::ceil(4 * coarse.length_px));
  Smoothing fine = how;
  fine.tension_px = margin;
  const int side = std::max(4 * margin, static_cast<int>(how.cell_px * std::sqrt(options.max_unknowns)) - 2 * margin);
  const Size cuts = cells_over(box.size(), side);
  const TiledImage tiled(box, cuts.width, cuts.height, margin);
  double noise2 = 0, counted = 0;
  const int tiles = tiled.tiles();
  std::vector<std::optional<SplineFit>> fits(static_cast<std::size_t>(std::max(context.threads, 1)));
  Context inner = context;
  inner.threads = 1;
  for (int first = 0; first < tiles; first += static_cast<int>(fits.size())) {
    context.progress("prior", 0.3 + 0.6 * first / tiles, "smoothing the cloud");
    parallel_for(context, fits.size(), 1, [&](std::size_t i, std::size_t) {
      const int tile = first + static_cast<int>(i);
      fits[i].reset();
      if (tile >= tiles) return;
      const PixelRect area = tiled.box(tile);
      const bool has_object = bounding_box(mask, area).height() > 0;
      if (has_object) fits[i] = fit_robust(mask, area, fine, points, options.sigma_samples, inner);
    });
    for (std::size_t i = 0; i < fits.size(); ++i) {
      if (!fits[i]) continue;
      const int tile = first + static_cast<int>(i);
      add_to(surface, *fits[i], mask, context, [&](int u, int v) { return tiled.weight(tile, u, v); });
      noise2 += fits[i]->noise2 * static_cast<double>(fits[i]->spline.points());
      counted += static_cast<double>(fits[i]->spline.points());
    }
  }
  surface.noise = std::sqrt(noise2 / counted);
  return surface;
}

/// What a cloud's scatter says of its errors: of points of a sweep's windows the sweep states them.
enum class Points { measured, of_windows };

/// Neighboring pixels of a surface that was measured and smoothed share their errors.
constexpr double independent_px = 4;

/// Whether points scatter by less than a tenth of their distance, or of a GSD if this is less: points measured in
/// photos scatter more, so these were smoothed, as the vertices of a mesh are, and their errors do not show as scatter.
/// `points_a_pixel` were merged into each. Their distance is that of the pixels, divided by its root; their mean
/// scatters nearly as much as one of them, because neighbors share most of their errors.
bool are_smoothed(double scatter_gsd, double points_a_pixel) {
  constexpr double least_scatter = 0.1;
  return scatter_gsd < least_scatter / std::sqrt(points_a_pixel);
}

/// Whether the scatter is that about a surface smoothed as the cloud asks for: with less smoothing points scatter less.
bool chooses_smoothing(const PriorOptions& options) {
  return !options.smoothing_px && options.smoothing_scale >= PriorOptions{}.smoothing_scale;
}

void warn_of_smoothed_points(double scatter_gsd, const PriorOptions& options, const Context& context) {
  std::ostringstream message;
  message
      << "prior cloud: its points scatter by only " << with_digits(scatter_gsd, 2)
      << " GSD, less than points measured in photos do: they were probably smoothed, as the vertices of a mesh are. "
         "Their scatter does not show their errors, so a standard deviation of "
      << with_digits(options.raster_sigma_gsd, 3) << " GSD is assumed: state sigma in [prior]";
  context.log(LogLevel::warning, message.str());
}

/// Standard deviation of a cloud's points, in the station's unit.
double stated_or_measured(double measured, const PriorOptions& options, const Context& context) {
  constexpr double contradicts = 3;
  if (!options.sigma) return measured;
  if (measured > contradicts * *options.sigma) {
    std::ostringstream message;
    message << "prior cloud: its points scatter by " << with_digits(measured, 3)
            << " about their surface, but sigma states " << with_digits(*options.sigma, 3)
            << ", which is used: check its unit";
    context.log(LogLevel::warning, message.str());
  }
  return *options.sigma;
}

/// Smoothing of the cloud: `smoothing_px`, or estimated from the cloud's noise and density.
Smoothing smoothing_for(const VisiblePoints& visible, const Mask& mask, const PriorOptions& options,
                        const Context& context) {
  // λ smooths over (λ² / points per square pixel)^¼ pixels.
  const double spacing_px = visible.spacing_px;
  Smoothing how;
  how.strength = choose_smoothing(mask, bounding_box(mask), visible.points, spacing_px, options.keep_raised, context);
  how.length_px = options.smoothing_px ? *options.smoothing_px
                                       : options.smoothing_scale * std::sqrt(spacing_px * how.strength.lambda);
  how.strength.lambda = how.length_px * how.length_px / spacing_px;
  // Points with little scatter get little smoothing. The cells still need not be finer than those used to choose the
  // smoothing: points say nothing about the surface between them, so finer cells only take time.
  how.cell_px = std::max(cell_for_spacing(spacing_px), 0.7 * how.length_px);
  how.tension_px = options.tension_spacings * spacing_px;
  how.edge_tolerance = options.edge_tolerance;
  how.keep_raised = options.keep_raised;
  return how;
}

DepthPrior empty_prior(const Pinhole& camera, const Pose& pose) {
  const Image<float> nothing(camera.size, 1, no_value);
  return {nothing, nothing, camera, pose};
}

/// Standard deviation of a raster's depth: `sigma`, or else `raster_sigma_gsd`.
double raster_sigma(double depth, double focal, const PriorOptions& options) {
  return options.sigma ? *options.sigma : options.raster_sigma_gsd * depth / focal;
}

/// Pixels without a depth.
Mask missing_in(const Image<float>& depth) {
  Mask missing(depth.size());
  for (std::size_t i = 0; i < depth.count(); ++i) missing[i] = depth[i] > 0 ? 0 : 255;
  return missing;
}

/// Distance of each pixel from the nearest one that has a depth, in px.
cv::Mat distance_from_known(const Image<float>& depth) {
  const Mask missing = missing_in(depth);
  cv::Mat distance;
  cv::distanceTransform(as_mat(missing), distance, cv::DIST_L2, cv::DIST_MASK_PRECISE);
  return distance;
}

/// Fills object pixels without a depth by a spline through their surroundings. Their sigma grows with the distance from
/// the rim, because unseen parts may deviate from their surroundings.
void fill_holes(DepthPrior& prior, const Mask& mask, const PriorOptions& options, const Context& context) {
  constexpr int surroundings_px = 8;
  Mask holes(mask.size());
  for (std::size_t i = 0; i < holes.count(); ++i) holes[i] = mask[i] != 0 && std::isnan(prior.depth[i]);
  const auto hole_pixels = static_cast<double>(count_of_set(holes));
  if (hole_pixels == 0) return;
  const int width = 2 * surroundings_px + 1;
  Mask region = holes;
  cv::Mat growing = as_mat(region);
  cv::dilate(growing, growing, cv::getStructuringElement(cv::MORPH_RECT, {width, width}));
  LargeVector<ViewPoint> points;
  std::vector<float> depths;
  for_each_pixel(mask.size(), [&](int u, int v) {
    if (mask(u, v) == 0) region(u, v) = 0;
    if (region(u, v) == 0 || !std::isfinite(prior.depth(u, v))) return;
    depths.push_back(prior.depth(u, v));
    points.push_back(ViewPoint::without_normal(static_cast<float>(u), static_cast<float>(v), 0));
  });
  if (depths.size() < 3) throw data_error("prior: the object's holes have no depth around them to be filled from");
  const double focal = prior.camera.focal(), reference = median(depths);
  for (std::size_t i = 0; i < points.size(); ++i) {
    points[i].height = static_cast<float>(focal * std::log(depths[i] / reference));
  }
  const ReferencePlane plane(points);
  for (ViewPoint& p : points) lower(p, plane.at(p.u, p.v), plane.slope());
  Smoothing how;
  how.strength.lambda = how.length_px = how.cell_px = 1;
  how.tension_px = options.tension_spacings;
  how.edge_tolerance = options.edge_tolerance;
  const Surface surface = smooth_cloud(std::move(points), region, how, options, context);
  const cv::Mat from_rim = distance_from_known(prior.depth);
  parallel_pixels(context, holes, [&](int u, int v) {
    const double depth = reference * std::exp((surface.height(u, v) + plane.at(u, v)) / focal), gsd = depth / focal;
    prior.depth(u, v) = static_cast<float>(depth);
    prior.sigma(u, v) = static_cast<float>(std::hypot(raster_sigma(depth, focal, options),
                                                      surface.noise * std::sqrt(surface.variance(u, v)) * gsd,
                                                      options.hole_slope * gsd * from_rim.at<float>(v, u)));
  });
  prior.filled_fraction = hole_pixels / static_cast<double>(count_of_set(mask));
}

/// The number that stands for "no depth" in a raster of a program that writes a large one there, such as 65535, 1e6 or
/// 3.4e38: the largest on the object, if several pixels have it and it lies far behind the other depths.
std::optional<float> number_for_no_depth(const Image<float>& depth, const Mask& mask) {
  constexpr double far = 3;
  const auto is_known = [&](std::size_t i) { return mask[i] != 0 && std::isfinite(depth[i]) && depth[i] > 0; };
  float largest = 0;
  std::size_t pixels = 0;
  for (std::size_t i = 0; i < depth.count(); ++i) {
    if (!is_known(i) || depth[i] < largest) continue;
    pixels = depth[i] > largest ? 1 : pixels + 1;
    largest = depth[i];
  }
  if (pixels < 2) return std::nullopt;  // as for most maps, whose depths then need not be copied
  std::vector<float> others;
  for (std::size_t i = 0; i < depth.count(); ++i) {
    if (is_known(i) && depth[i] < largest) others.push_back(depth[i]);
  }
  if (others.empty() || largest < far * median_in_place(others)) return std::nullopt;
  return largest;
}

/// Declares the depth's standard deviation to be noise, like that of a cloud's points, so that the fusion averages it
/// over an area. Holes must not be filled yet: their standard deviation is no noise.
void set_noise(DepthPrior& prior) {
  std::vector<float> sigmas;
  std::copy_if(prior.sigma.begin(), prior.sigma.end(), std::back_inserter(sigmas), [](float s) { return s > 0; });
  prior.noise = median_in_place(sigmas);
  prior.spacing_px = independent_px;
}

enum class Deviation { noise, systematic };

/// Prior of a depth raster in the station view; `source` names it in messages.
DepthPrior prior_of_raster(const Image<float>& depth, const std::string& source, Deviation deviation,
                           const Pinhole& camera, const Pose& pose, const Mask& mask, const PriorOptions& options,
                           const Context& context) {
  const OpenCvThreads opencv_threads(context.threads);
  DepthPrior prior = empty_prior(camera, pose);
  std::size_t known = 0, elsewhere = 0;
  for (std::size_t i = 0; i < depth.count(); ++i) {
    const bool usable = std::isfinite(depth[i]) && depth[i] > 0;
    if (mask[i] == 0 || !usable) {
      elsewhere += usable;
      continue;
    }
    ++known;
    prior.depth[i] = depth[i];
    prior.sigma[i] = static_cast<float>(raster_sigma(depth[i], camera.focal(), options));
  }
  if (known < static_cast<std::size_t>(options.min_points)) {
    throw data_error(source + ": " + std::to_string(known) + " object pixels have a depth, expected at least " +
                     std::to_string(options.min_points) + " (" + std::to_string(elsewhere) +
                     " pixels outside the mask have one): check that it and the camera pose are in one frame and unit");
  }
  prior.spacing_px = 1;
  if (deviation == Deviation::noise) set_noise(prior);
  fill_holes(prior, mask, options, context);
  prior.points_total = static_cast<double>(known + elsewhere);
  prior.points_used = static_cast<double>(known);
  prior.assumes_sigma = !options.sigma;
  return prior;
}

/// A sweep's depths, and those of the hull where it has none; NaN = none. Shares of the object's pixels.
struct Measured {
  Image<float> depth, sigma;
  double filled_fraction = 0, hull_fraction = 0;
};

Measured measured_depths(const SweptDepth& swept, const Mask& mask) {
  const bool has_hull = swept.hull.count() != 0;
  if (has_hull) {
    require_size(swept.hull, mask.size(), "visual hull");
    require_size(swept.hull_sigma, mask.size(), "standard deviation of the visual hull");
  }
  const auto usable = [](float z, float sigma) {
    return std::isfinite(z) && z > 0 && std::isfinite(sigma) && sigma > 0;
  };
  Measured all{swept.depth, swept.sigma};
  double object = 0, hull = 0, missing = 0;
  for (std::size_t i = 0; i < mask.count(); ++i) {
    const bool is_object = mask[i] != 0;
    object += is_object;
    if (usable(all.depth[i], all.sigma[i])) continue;
    const bool of_hull = has_hull && usable(swept.hull[i], swept.hull_sigma[i]);
    all.depth[i] = of_hull ? swept.hull[i] : std::numeric_limits<float>::quiet_NaN();
    if (of_hull) all.sigma[i] = swept.hull_sigma[i];
    (of_hull ? hull : missing) += is_object;
  }
  all.hull_fraction = hull / object;
  all.filled_fraction = missing / object;
  return all;
}

/// The depths, each pixel without one with that of the nearest pixel that has one.
Image<float> filled_from_nearest(Image<float> depth) {
  const Mask missing = missing_in(depth);
  cv::Mat distance, labels;
  cv::distanceTransform(as_mat(missing), distance, labels, cv::DIST_L2, cv::DIST_MASK_5, cv::DIST_LABEL_PIXEL);
  const int* const label = labels.ptr<int>();
  std::vector<float> of_label(depth.count() + 1);
  for (std::size_t i = 0; i < depth.count(); ++i) {
    if (depth[i] > 0) of_label[static_cast<std::size_t>(label[i])] = depth[i];
  }
  for (std::size_t i = 0; i < depth.count(); ++i) depth[i] = of_label[static_cast<std::size_t>(label[i])];
  return depth;
}

/// A shape divided by its mean depth (1 without a shape). A surface divided by this is flat where it follows the shape.
Image<float> relative_shape(const Image<float>& shape, const Mask& mask) {
  Image<float> relative(mask.size(), 1, 1.0F);
  if (shape.count() == 0) return relative;
  require_size(shape, mask.size(), "shape of the prior depth map");
  double sum = 0, count = 0;
  for (std::size_t i = 0; i < shape.count(); ++i) {
    if (mask[i] == 0) continue;
    if (!(std::isfinite(shape[i]) && shape[i] > 0)) {
      throw input_error("shape of the prior depth map: expected a positive depth at every pixel of the object");
    }
    sum += shape[i];
    ++count;
  }
  for (std::size_t i = 0; i < shape.count(); ++i) {
    if (mask[i] != 0) relative[i] = static_cast<float>(shape[i] * count / sum);
  }
  return relative;
}

/// Coarse surface from a cloud, or from the points of another surface.
DepthPrior prior_of_cloud(const PointCloud& cloud, Points points, const Pinhole& camera, const Pose& pose,
                          const Mask& mask, const PriorOptions& options, const Context& context) {
  const OpenCvThreads opencv_threads(context.threads);
  validate(camera, pose, mask, options);
  context.progress("prior", 0, "projecting the cloud");
  warn_if_rounded(cloud, camera, pose, "prior cloud", context);
  VisiblePoints visible = visible_points(cloud, camera, pose, mask, options, context);
  require_points(visible, options);
  warn_of_turned_patches(visible.census, context);
  const ReferencePlane plane(visible.points);
  for (ViewPoint& p : visible.points) lower(p, plane.at(p.u, p.v), plane.slope());
  context.progress("prior", 0.15, "choosing the smoothing");
  const Smoothing how = smoothing_for(visible, mask, options, context);
  context.progress("prior", 0.3, "smoothing the cloud");
  DepthPrior prior = empty_prior(camera, pose);
  // Farther than this from every point the surface is interpolated.
  const double near_px = 2 * visible.spacing_px;
  const cv::Mat from_points = distance_from_points(mask.size(), visible.points);
  prior.filled_fraction = far_fraction(mask, from_points, near_px);
  const double points_a_pixel = static_cast<double>(visible.census.used) / static_cast<double>(visible.points.size());
  const Surface surface = smooth_cloud(std::move(visible.points), mask, how, options, context);
  const double focal = camera.focal();
  const double gsd = visible.reference_depth / focal;
  prior.spacing_px = visible.spacing_px;
  prior.assumes_sigma = points == Points::measured && !options.sigma && chooses_smoothing(options) &&
                        are_smoothed(surface.noise, points_a_pixel);
  if (prior.assumes_sigma) {
    warn_of_smoothed_points(surface.noise, options, context);
    prior.noise = options.raster_sigma_gsd * gsd;
    prior.spacing_px = std::max(prior.spacing_px, independent_px);
  } else {
    // Swept depths may lie exactly in a plane; a noise of zero would stand for none.
    constexpr double least_noise_gsd = 1e-6;
    prior.noise = stated_or_measured(std::max(surface.noise, least_noise_gsd) * gsd, options, context);
  }
  const double noise = prior.noise / gsd;
  const double shared2 = options.correlated_noise * options.correlated_noise;
  parallel_pixels(context, mask, [&](int u, int v) {
    const double depth = visible.reference_depth * std::exp((surface.height(u, v) + plane.at(u, v)) / focal);
    prior.depth(u, v) = static_cast<float>(depth);
    // The spline's variance is that of a surface as smooth as a hole's rim.
    const double hole = options.hole_slope * std::max(from_points.at<float>(v, u) - near_px, 0.0);
    const double factor = prior.assumes_sigma ? 1 : std::sqrt(surface.variance(u, v) + shared2);
    prior.sigma(u, v) = static_cast<float>(std::hypot(noise * factor, hole) * depth / focal);
  });
  prior.points_total = static_cast<double>(visible.census.total);
  prior.points_used = static_cast<double>(visible.census.used);
  // A surface that somebody else smoothed has lost detail over a length that nobody knows, as a mesh or a depth map
  // has.
  prior.smoothing_px = prior.assumes_sigma ? 0 : how.length_px;
  context.progress("prior", 1);
  return prior;
}

}  // namespace

DepthPrior project_prior(const PointCloud& cloud, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context) {
  return prior_of_cloud(cloud, Points::measured, camera, pose, mask, options, context);
}

DepthPrior project_prior(const TriangleMesh& mesh, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context) {
  validate(camera, pose, mask, options);
  context.progress("prior", 0, "rasterizing the mesh");
  warn_if_rounded(mesh.vertices, camera, pose, "prior mesh", context);
  return prior_of_raster(rasterize_mesh(mesh, camera, pose, context), "prior mesh", Deviation::noise, camera, pose,
                         mask, options, context);
}

void require_depth_map(const Image<float>& depth, Size size) {
  require_size(depth, size, "prior depth map");
  if (depth.channels() != 1)
    throw input_error("prior depth map has " + std::to_string(depth.channels()) + " channels, expected 1");
}

std::optional<Image<float>> without_number_for_no_depth(const Image<float>& depth, const Mask& mask,
                                                        const Context& context) {
  const std::optional<float> number = number_for_no_depth(depth, mask);
  if (!number) return std::nullopt;
  Image<float> rest = depth;
  std::size_t pixels = 0;
  for (std::size_t i = 0; i < rest.count(); ++i) {
    if (rest[i] != *number) continue;
    rest[i] = no_value;
    pixels += mask[i] != 0;
  }
  context.log(LogLevel::warning, "prior depth map: " + std::to_string(pixels) +
                                     " of the object's pixels have the depth " + with_digits(*number, 6) +
                                     ", far behind all others: taken as pixels without a depth; write NaN there");
  return rest;
}

DepthPrior project_prior(const Image<float>& depth, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context) {
  validate(camera, pose, mask, options);
  require_depth_map(depth, camera.size);
  const auto of = [&](const Image<float>& known) {
    return prior_of_raster(known, "prior depth map", Deviation::noise, camera, pose, mask, options, context);
  };
  const std::optional<Image<float>> without_number = without_number_for_no_depth(depth, mask, context);
  return of(without_number ? *without_number : depth);
}

void require_sigma(const Shape& shape, const PriorOptions& options) {
  if (options.sigma) return;
  throw input_error("prior " + std::string(name_of(shape)) +
                    ": sigma is missing, expected how far the object is from the shape, one standard deviation in the "
                    "station's unit");
}

DepthPrior project_prior(const Shape& shape, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context) {
  validate(camera, pose, mask, options);
  require_sigma(shape, options);
  return prior_of_raster(depth_of_shape(shape, camera, pose), "prior " + std::string(name_of(shape)),
                         Deviation::systematic, camera, pose, mask, options, context);
}

DepthPrior project_prior(const SweptDepth& swept, const Pinhole& camera, const Pose& pose, const Mask& mask,
                         const PriorOptions& options, const Context& context) {
  const OpenCvThreads opencv_threads(context.threads);
  validate(camera, pose, mask, options);
  require_size(swept.depth, camera.size, "prior depth map");
  require_size(swept.sigma, camera.size, "standard deviation of the prior depth map");
  const Measured measured = measured_depths(swept, mask);
  const Image<float>&depth = measured.depth, &sigma = measured.sigma;
  // A hull that gives most of the depths keeps its form, and only what the sweep adds to it is smoothed.
  const bool is_hull = swept.shape.count() == 0 && measured.hull_fraction > 0.5;
  const Image<float> shape = relative_shape(is_hull ? filled_from_nearest(swept.hull) : swept.shape, mask);
  constexpr int stride = 4;
  const auto known = [&](int u, int v) { return depth(u, v) > 0; };
  PointCloud cloud;
  for (int v = 0; v < depth.height(); v += stride) {
    for (int u = 0; u < depth.width(); u += stride) {
      if (!known(u, v)) continue;
      cloud.points.push_back(pose.world_from_cam(depth(u, v) / shape(u, v) * camera.ray(u, v)));
    }
  }
  if (cloud.points.empty()) {
    throw data_error(
        "the photos give no depth on the object: they agree nowhere; give a prior of another source or masks of the "
        "photos, or photograph it sharper, with more texture on or around it, and from more sides 25 to 40 degrees off "
        "the station");
  }
  // Neighbors that share their windows agree even if they are wrong, so their agreement is no reason to keep a raised
  // part.
  PriorOptions of_windows = options;
  of_windows.keep_raised = false;
  of_windows.hole_slope = 0;  // holes are those of the map, below
  DepthPrior prior = prior_of_cloud(cloud, Points::of_windows, camera, pose, mask, of_windows, context);
  const cv::Mat distance = distance_from_known(depth);
  prior.filled_fraction = measured.filled_fraction;
  prior.hull_fraction = measured.hull_fraction;
  if (is_hull) prior.smoothing_px = 0;
  prior.shares_windows = true;
  parallel_pixels(context, mask, [&](int u, int v) {
    prior.depth(u, v) *= shape(u, v);
    float& value = prior.sigma(u, v);
    value *= shape(u, v);
    if (known(u, v)) {
      value = std::max(value, sigma(u, v));
      return;
    }
    const double gsd = prior.depth(u, v) / camera.focal();
    value = static_cast<float>(std::hypot(value, options.hole_slope * gsd * distance.at<float>(v, u)));
  });
  return prior;
}

}  // namespace malus
