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
    visit("max_features", self.max_features, Range{500, 1e6},
          "largest number of features that are taken from each photo");
    visit("max_side_px", self.max_side_px, Range{200, 1e5},
          "photographs with a longer side are reduced to this size before feature points are searched in them, in px: "
          "smaller is faster, larger finds more points");
    visit("guided_matching", self.guided_matching, any_value,
          "once photos are matched, search along their epipolar lines for further matches");
    visit("exhaustive_limit", self.exhaustive_limit, Range{2, 1e6},
          "up to this many photos, all pairs are matched; with more photos, mainly those close to each other in the "
          "order of their names, in which the first follows the last");
    visit("min_inliers", self.min_inliers, Range{6, 1e4},
          "two photos with fewer consistent matches do not count as a pair");
    visit("max_error_px", self.max_error_px, Range{0.01, 100},
          "image measurements whose reprojection error exceeds both this, in px, and 2.5 times the mean of all points "
          "are left out of the last adjustments");
    visit("match_windows", self.match_windows, any_value,
          "measure the points again by least-squares matching of image windows, and adjust all cameras to these "
          "measurements");
    visit("match_points_a_photo", self.match_points_a_photo, Range{30, 1e6},
          "match_windows: points are measured again until each photo has this many, those seen in many photos first; a "
          "photo may get more where other photos still have too few");
    visit("match_radius", self.match_radius, Range{3, 32},
          "match_windows: radius of the square windows, in px; where noise hides the texture, windows of twice this "
          "radius are matched in coarser images");
    visit("match_range_px", self.match_range_px, Range{0.1, 100},
          "match_windows: windows that end farther than this from their predicted position are left out, in px");
    visit("match_min_correlation", self.match_min_correlation, fraction_range,
          "match_windows: windows with a lower correlation are left out");
    visit("match_floor_px", self.match_floor_px, Range{1e-4, 10},
          "match_windows: lower limit of the standard deviation of a window's position, in px");
    visit("search_limit_s", self.search_limit_s, Range{5, 1e6},
          "longest search for a first pair of photos before the next assumed focal length is tried, in s; holds for up "
          "to 20 photos and grows in proportion with more");
    visit("mark_sigma_px", self.mark_sigma_px, Range{1e-3, 100}, "standard deviation of a mark in [[scale]], in px");
    visit("target_sigma_px", self.target_sigma_px, Range{1e-3, 100},
          "standard deviation of a coded target's center, in px");
    visit("distance_sigma_relative", self.distance_sigma_relative, Range{0, 0.1},
          "standard deviation of a distance in [[scale]], as a share of the distance");
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
          "the station's linear intensity is raised to the power 1 / this, so that it is coded like the photos; 1 = it "
          "stays linear");
    visit("window_radius", self.window_radius, Range{1, 4}, "radius of the square windows that are compared, in px");
    visit("known_window_radius", self.known_window_radius, Range{1, 8},
          "radius of the windows in a sweep about a known surface, in px; larger than window_radius, because these "
          "windows lie on that surface");
    visit("best_views", self.best_views, Range{1, 16},
          "number of photos that count at a pixel: the score of a depth is the mean of this many highest correlations");
    visit("max_views", self.max_views, Range{1, 64},
          "largest number of photos that are compared in one part of the image");
    visit("min_level_px", self.min_level_px, Range{16, 1e6},
          "smallest length of the shorter side of the coarsest image of the pyramid, in px");
    visit("min_points", self.min_points, Range{3, 1e9},
          "the sweep ends with an error if fewer triangulated points lie on the object");
    visit("noise", self.noise, Range{1e-5, 1}, "standard deviation of the photos' noise, as a share of white");
    visit("min_parallax", self.min_parallax, fraction_range,
          "photos whose parallax is below this share of the photos' median are left out if enough other photos remain "
          "(twice best_views)");
    visit("max_angle_deg", self.max_angle_deg, Range{1, 89},
          "photos that see the object at a larger angle to the station's view are left out, in degrees");
    visit(
        "max_search", self.max_search, Range{4, 1000},
        "largest search distance from the surface of the triangulated points, as parallax in px of the coarsest image");
    visit("small_step", self.small_step, not_negative,
          "penalty where the depths of neighboring pixels differ by one search step, in units of correlation; larger "
          "is smoother");
    visit("large_step", self.large_step, not_negative,
          "penalty where the depths of neighboring pixels differ by more than one search step, in units of "
          "correlation; larger gives fewer depth jumps");
    visit("min_score", self.min_score, fraction_range, "pixels with a lower mean correlation get no depth");
    visit("min_agreement", self.min_agreement, fraction_range,
          "the photos are split into two halves; a pixel keeps its depth if both halves agree on at least this share "
          "of the pixels around it");
    visit("min_region_px", self.min_region_px, not_negative,
          "connected regions of fewer pixels are dropped: depths that agree by chance form small regions");
    visit("sigma_scale", self.sigma_scale, Range{0, 100},
          "the standard deviation of depth is this factor times half the RMS difference between the depths from two "
          "halves of the photos");
    visit("sigma_floor_gsd", self.sigma_floor_gsd, not_negative,
          "smallest standard deviation that a swept depth may have, in GSD");
    visit("again", self.again, any_value,
          "sweep the photographs a second time, close to the fused surface, and fuse with the new depths; if the first "
          "sweep found little, only drop its depths that contradict the fused surface");
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
    visit(
        "sigma", self.sigma, Range{1e-12, 1e12},
        "standard deviation of a cloud's points or of another prior's depth, in the station's unit; auto = from the "
        "station file, else measured (cloud) or raster_sigma_gsd (mesh, depth map, cloud that was smoothed); required "
        "for a shape");
    visit("smoothing_px", self.smoothing_px, Range{0.1, 1000.0},
          "length over which a cloud is smoothed, in px: larger removes more noise, smaller keeps more detail; auto = "
          "estimated from the cloud's noise and density");
    visit("smoothing_scale", self.smoothing_scale, Range{0.1, 10},
          "factor on the automatic smoothing_px; below 1 because fusion cannot restore detail that was smoothed away, "
          "but can reduce noise");
    visit("edge_tolerance", self.edge_tolerance, Range{0.01, 1e12},
          "bending, as a multiple of what is usual, at which the smoothing is halved: steps and occluding edges stay "
          "sharp; larger smooths them more");
    visit("keep_raised", self.keep_raised, any_value,
          "keep points that stand out toward the camera as a part of the surface if many of their neighbors do, too; "
          "single points are never kept");
    visit("neighbors", self.neighbors, Range{3, 100},
          "number of nearest neighbors, in the image, that a point of the cloud is compared with");
    visit("outlier_tolerance", self.outlier_tolerance, Range{1, 100},
          "a point is an outlier if its distance from the median depth of its neighbors exceeds both this many robust "
          "standard deviations and outlier_floor_gsd");
    visit("outlier_floor_gsd", self.outlier_floor_gsd, not_negative,
          "points closer than this to the median depth of their neighbors are never outliers, in GSD");
    visit("max_slope_deg", self.max_slope_deg, Range{1, 89},
          "steepest slope that a visible surface can have, in degrees; points that lie deeper behind the points around "
          "them count as hidden");
    visit("min_points", self.min_points, Range{3, 1e9},
          "the run ends with an error if fewer points of the cloud, or pixels of another prior, are visible on the "
          "object");
    visit("raster_sigma_gsd", self.raster_sigma_gsd, Range{1e-6, 1e6},
          "standard deviation of a mesh's, a depth map's or a smoothed cloud's depth, in GSD, where none is stated");
    visit("correlated_noise", self.correlated_noise, Range{0, 10},
          "share of a point's noise that its neighbors have in common: smoothing does not reduce it, so it stays in "
          "the prior's standard deviation");
    visit("tension_spacings", self.tension_spacings, Range{1, 1e6},
          "distance from all points, in point spacings, beyond which the surface levels out to the plane of the cloud");
    visit("hole_slope", self.hole_slope, not_negative,
          "growth of the depth's standard deviation inside holes of the prior, in GSD per px from the rim (in a cloud: "
          "beyond two point spacings from the nearest point): unseen parts, such as highlights, may deviate from their "
          "surroundings");
    visit("max_unknowns", self.max_unknowns, Range{1000, 1e7},
          "largest number of unknowns of the smoothing that are solved at once; larger rasters are solved in "
          "overlapping tiles");
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
