#pragma once

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
          "what runs COLMAP: the program, the Python package pycolmap, or the program if there is one and else the "
          "package");
    visit("max_features", self.max_features, Range{500, 1e6}, "most features of a photo");
    visit("max_side_px", self.max_side_px, Range{200, 1e5}, "photos with a longer side are reduced to find features");
    visit("guided_matching", self.guided_matching, any_value,
          "search again for matches along the epipolar lines of the first");
    visit("exhaustive_limit", self.exhaustive_limit, Range{2, 1e6},
          "most photos of which every pair is matched; of more, only photos near each other in their names' order");
    visit("min_inliers", self.min_inliers, Range{6, 1e4}, "fewest matches that make two photos a pair");
    visit("max_error_px", self.max_error_px, Range{0.01, 100},
          "points with a larger mean reprojection error (and more than 2.5 times all points') are left out of the last "
          "adjustments");
    visit("match_windows", self.match_windows, any_value,
          "measure the points anew by least-squares matching of windows, and adjust all cameras to that");
    visit("match_points_a_photo", self.match_points_a_photo, Range{30, 1e6},
          "points of a photo that are measured so, those in many photos first");
    visit("match_radius", self.match_radius, Range{3, 32},
          "of the square windows, in px; twice this, of coarser images, where noise hides what is there");
    visit("match_range_px", self.match_range_px, Range{0.1, 100},
          "farthest a window may end from where the point is expected, in px");
    visit("match_min_correlation", self.match_min_correlation, fraction_range,
          "lowest correlation of a window that counts");
    visit("match_floor_px", self.match_floor_px, Range{1e-4, 10},
          "smallest standard deviation of a window's position, in px");
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

}  // namespace malus
