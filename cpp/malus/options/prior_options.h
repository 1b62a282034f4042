#pragma once

#include <array>
#include <optional>
#include <string_view>

#include "malus/core/fields.h"

namespace malus {

/// What runs COLMAP.
enum class ColmapBackend {
  automatic,  ///< the program if there is one, else the package
  program,
  package,
};
constexpr auto names_of(ColmapBackend) {
  return std::to_array<std::string_view>({"auto", "colmap", "pycolmap"});
}

/// How cameras are found from ordinary photos, and how the model gets its scale. The work itself is done by COLMAP,
/// which the Python package drives; the options are listed here with those of every other step.
struct PhotosOptions {
  ColmapBackend backend = ColmapBackend::automatic;
  int max_features = 8192;
  int max_side_px = 3200;
  bool guided_matching = false;
  int exhaustive_limit = 80;
  int min_inliers = 15;
  double max_error_px = 1;
  bool match_windows = true;
  int match_points_a_photo = 3000;
  int match_radius = 4;
  double match_range_px = 3;
  double match_min_correlation = 0.85;
  double match_floor_px = 0.03;
  int search_limit_s = 30;
  double mark_sigma_px = 0.3;
  double target_sigma_px = 0.1;
  double distance_sigma_relative = 1e-4;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("backend", self.backend, any_value,
          "what finds the cameras of the photographs: the program COLMAP, the Python package pycolmap, or auto = the "
          "program if it is installed, else the package");
    visit("max_features", self.max_features, Range{500, 1e6}, "largest number of features that are taken of a photo");
    visit("max_side_px", self.max_side_px, Range{200, 1e5},
          "photographs with a longer side are made smaller before points are looked for that several of them show: a "
          "smaller number is faster, a larger one finds more");
    visit("guided_matching", self.guided_matching, any_value,
          "once photos are matched, search along their epipolar lines for further matches");
    visit("exhaustive_limit", self.exhaustive_limit, Range{2, 1e6},
          "most photos of which every pair is matched; of more, only photos near each other in their names' order");
    visit("min_inliers", self.min_inliers, Range{6, 1e4}, "fewest matches that make two photos a pair");
    visit("max_error_px", self.max_error_px, Range{0.01, 100},
          "points with a larger mean reprojection error (and more than 2.5 times all points') are left out of the last "
          "adjustments");
    visit("match_windows", self.match_windows, any_value,
          "measure the points anew by least-squares matching of windows, and adjust all cameras to that");
    visit("match_points_a_photo", self.match_points_a_photo, Range{30, 1e6},
          "match_windows: largest number of points that are measured anew in a photo, those seen in many photos first");
    visit("match_radius", self.match_radius, Range{3, 32},
          "radius of the square windows, in px; twice as large, in coarser images, where noise hides the texture");
    visit("match_range_px", self.match_range_px, Range{0.1, 100},
          "match_windows: farthest that a window may end from where its point is expected, in px");
    visit("match_min_correlation", self.match_min_correlation, fraction_range,
          "match_windows: windows with a lower correlation are left out");
    visit("match_floor_px", self.match_floor_px, Range{1e-4, 10},
          "match_windows: smallest standard deviation that a window's position may have, in px");
    visit("search_limit_s", self.search_limit_s, Range{5, 1e6},
          "longest search for a first pair, for 20 photos, before the next assumption on the focal length is tried, in "
          "s");
    visit("mark_sigma_px", self.mark_sigma_px, Range{1e-3, 100}, "standard deviation of a mark in [[scale]], in px");
    visit("target_sigma_px", self.target_sigma_px, Range{1e-3, 100},
          "standard deviation of a coded target's center, in px");
    visit("distance_sigma_relative", self.distance_sigma_relative, Range{0, 0.1},
          "standard deviation of a distance in [[scale]], as a share of it");
  }
};

struct SweepOptions {
  double station_gamma = 2.2;
  int window_radius = 3;
  int known_window_radius = 7;
  int best_views = 5;
  int max_views = 10;
  int min_level_px = 100;
  int min_points = 10;
  double noise = 0.002;
  double min_parallax = 0.6;
  double max_angle_deg = 70;
  int max_search = 64;
  double small_step = 0.02;
  double large_step = 0.15;
  double min_score = 0.3;
  double min_agreement = 0.6;
  int min_region_px = 400;
  double sigma_scale = 2.6;
  double sigma_floor_gsd = 0.2;
  bool again = true;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("station_gamma", self.station_gamma, Range{0.2, 5},
          "the station's linear intensity is raised to 1 / this, to be coded like the photos; 1 = as it is");
    visit("window_radius", self.window_radius, Range{1, 4}, "radius of the square windows that are compared, in px");
    visit("known_window_radius", self.known_window_radius, Range{1, 8},
          "radius of the windows in a sweep about a known surface, in px; larger, as they lie on that surface");
    visit("best_views", self.best_views, Range{1, 16}, "number of photos whose match counts at a pixel, the best ones");
    visit("max_views", self.max_views, Range{1, 64},
          "largest number of photos that are compared in one part of the image");
    visit("min_level_px", self.min_level_px, Range{16, 1e6}, "shorter side of the coarsest image, at least, in px");
    visit("min_points", self.min_points, Range{3, 1e9}, "fewest triangulated points on the object");
    visit("noise", self.noise, Range{1e-5, 1}, "standard deviation of the photos' noise, as a share of white");
    visit("min_parallax", self.min_parallax, fraction_range,
          "photos with less parallax than this, of the photos' median, are left out if others suffice");
    visit("max_angle_deg", self.max_angle_deg, Range{1, 89}, "largest angle between a photo's view and the station's");
    visit("max_search", self.max_search, Range{4, 1000},
          "farthest offset from the triangulated points' surface, in px of the coarsest image");
    visit("small_step", self.small_step, not_negative, "penalty of neighbors one offset apart, in correlation");
    visit("large_step", self.large_step, not_negative, "penalty of neighbors farther apart, in correlation");
    visit("min_score", self.min_score, fraction_range, "lowest mean correlation of a pixel that is kept");
    visit("min_agreement", self.min_agreement, fraction_range,
          "share of the pixels around it at which the two halves of the photos must agree for a pixel to be kept");
    visit("min_region_px", self.min_region_px, not_negative,
          "fewest connected pixels that are kept: what agrees by chance comes in small regions");
    visit("sigma_scale", self.sigma_scale, Range{0, 100},
          "factor from half the difference of the two halves' depths to the standard deviation of depth");
    visit("sigma_floor_gsd", self.sigma_floor_gsd, not_negative,
          "smallest standard deviation that a swept depth may have, in GSD");
    visit("again", self.again, any_value,
          "measure the surface in the photographs a second time, close to the fused one, and fuse with that; where "
          "they agree on too little, what the fused surface contradicts is left out instead");
  }
};

/// How a coarse surface becomes a depth map of the station.
struct PriorOptions {
  std::optional<double> sigma;
  std::optional<double> smoothing_px;
  double smoothing_scale = 0.8;
  double edge_tolerance = 1;
  bool keep_raised = true;
  int neighbors = 16;
  double outlier_tolerance = 4;
  double outlier_floor_gsd = 4;
  double max_slope_deg = 75;
  int min_points = 30;
  double raster_sigma_gsd = 1;
  double correlated_noise = 0.33;
  double tension_spacings = 40;
  double hole_slope = 1;
  int max_unknowns = 500000;
  int sigma_samples = 16;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("sigma", self.sigma, Range{1e-12, 1e12},
          "standard deviation of a cloud's points, or of the depth of another prior, in the station's unit; left out = "
          "the station file's, and without it a cloud's is measured and another's is raster_sigma_gsd");
    visit("smoothing_px", self.smoothing_px, Range{0.1, 1000.0},
          "over how many pixels a cloud is smoothed: more takes away more of its noise, less keeps more of its "
          "detail; auto = as its noise and its density ask for");
    visit("smoothing_scale", self.smoothing_scale, Range{0.1, 10},
          "the estimated smoothing length times this; below 1 because what is smoothed away is lost to the fusion, "
          "noise is not");
    visit("edge_tolerance", self.edge_tolerance, Range{0.01, 1e12},
          "bending, over what is usual, at which the smoothing gives way to a step or an occluding edge");
    visit("keep_raised", self.keep_raised, any_value,
          "whether points that stand out together are kept as a part of the surface; strays never are");
    visit("neighbors", self.neighbors, Range{3, 100},
          "number of nearest neighbors, in the image, that a point of the cloud is compared with");
    visit("outlier_tolerance", self.outlier_tolerance, Range{1, 100},
          "a point is an outlier if it is farther from the median depth of its neighbors, in their robust standard "
          "deviations");
    visit("outlier_floor_gsd", self.outlier_floor_gsd, not_negative,
          "distance from the median depth of its neighbors that makes no point an outlier, in GSD");
    visit("max_slope_deg", self.max_slope_deg, Range{1, 89},
          "steepest slope of a visible surface; points farther behind their neighbors are hidden");
    visit("min_points", self.min_points, Range{3, 1e9}, "fewest visible points on the object");
    visit("raster_sigma_gsd", self.raster_sigma_gsd, Range{1e-6, 1e6},
          "standard deviation of a mesh's or a depth map's depth, in GSD, where none is stated");
    visit("correlated_noise", self.correlated_noise, Range{0, 10},
          "share of a point's noise that its neighbors have too, so that smoothing leaves it (for sigma)");
    visit("tension_spacings", self.tension_spacings, Range{1, 1e6},
          "distance from all points, in point spacings, beyond which the surface levels out to the plane of the cloud");
    visit("hole_slope", self.hole_slope, not_negative,
          "standard deviation of the slope where a swept depth map has none: what stereo does not see, such as the "
          "ridge of "
          "a highlight, need not go on as its surroundings do");
    visit("max_unknowns", self.max_unknowns, Range{1000, 1e7},
          "largest smoothing system solved at once; larger rasters are solved in overlapping tiles");
    visit("sigma_samples", self.sigma_samples, Range{4, 1000},
          "number of random draws from which the prior's standard deviation is estimated");
  }
};

struct EvidenceOptions {
  bool refuse = true;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("refuse", self.refuse, any_value,
          "end the run where an input is certainly wrong; false: go on, and say that the result has low confidence");
  }
};

}  // namespace malus
