#pragma once

#include <array>
#include <optional>
#include <string_view>

#include "malus/core/fields.h"

namespace malus {

struct SurfaceOptions {
  int subsample = 1;
  double max_incidence_deg = 85;
  double min_step_gsd = 4;
  double step_ratio = 3;
  std::optional<double> max_sigma_gsd;
  double white_percentile = 99.5;
  std::optional<double> dem_pixel;
  int glb_triangles = 500000;
  int glb_texture_px = 4096;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("subsample", self.subsample, Range{1, 64},
          "only every n-th pixel, across and down, becomes a vertex of the mesh: 2 makes a quarter of the triangles");
    visit("max_incidence_deg", self.max_incidence_deg, Range{45, 90},
          "triangles with a larger angle between normal and viewing ray are left out, in degrees: they are sides of "
          "depth steps");
    visit("min_step_gsd", self.min_step_gsd, not_negative,
          "depth steps between neighboring pixels up to this many GSD are never cut by step_ratio");
    visit("step_ratio", self.step_ratio, Range{1, 1e6},
          "the mesh is cut at a depth step larger than min_step_gsd if the step exceeds this many times the steps "
          "right before and after it");
    visit("max_sigma_gsd", self.max_sigma_gsd, Range{0.1, 1e9},
          "the mesh leaves out pixels whose standard deviation of depth exceeds this many GSD, such as ragged rims and "
          "guessed parts; auto = 10, or four times that of the coarse surface if this is more");
    visit("white_percentile", self.white_percentile, Range{1, 100},
          "intensity percentile that becomes white in the vertex colors");
    visit("dem_pixel", self.dem_pixel, Range{1e-9, 1e9},
          "side of a pixel of the elevation model (dem.tif), in the station's unit; auto = as fine as the mesh");
    visit("glb_triangles", self.glb_triangles, Range{100, 1e9},
          "surface.glb takes every n-th pixel as a vertex, with n so large that it has at most about this many "
          "triangles");
    visit("glb_texture_px", self.glb_texture_px, Range{16, 16384},
          "longest side of the texture in surface.glb; larger images are reduced by averaging");
  }
};

/// How the surface is moved onto a reference before distances are measured.
enum class Alignment { none, rigid, similarity };
constexpr auto names_of(Alignment) {
  return std::to_array<std::string_view>({"none", "rigid", "similarity"});
}

struct AssessOptions {
  bool polarization_height = true;
  double detail_sigma_px = 8;
  int histogram_bins = 0;
  std::optional<double> histogram_range_gsd;
  double sigma_limit_gsd = 1;
  double profile_step_px = 1;
  Alignment alignment = Alignment::none;
  double max_distance_gsd = 50;
  int reference_neighbors = 12;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("polarization_height", self.polarization_height, any_value,
          "compute zenith and height from polarization alone, too, to show them beside the fused surface; grid fusion "
          "needs them");
    visit("detail_sigma_px", self.detail_sigma_px, Range{0.5, 100},
          "standard deviation of the Gaussian that separates detail (what the Gaussian removes) from low frequencies, "
          "in px");
    visit("histogram_bins", self.histogram_bins, Range{0, 10000},
          "number of classes of the distance histograms; 0 = chosen by the spread and number of the distances");
    visit("histogram_range_gsd", self.histogram_range_gsd, Range{1e-6, 1e6},
          "histograms span minus to plus this, in GSD; auto = the range of the distances without far outliers");
    visit("sigma_limit_gsd", self.sigma_limit_gsd, Range{1e-6, 1e6},
          "pixels with a larger standard deviation of depth count as uncertain");
    visit("profile_step_px", self.profile_step_px, Range{0.05, 100},
          "largest distance between the samples of a profile, in px");
    visit("alignment", self.alignment, any_value,
          "move the surface onto the reference before they are compared: rigid = shift and turn it, similarity = "
          "change its size, too, none = leave it where it is");
    visit("max_distance_gsd", self.max_distance_gsd, Range{1e-3, 1e9},
          "points farther from the reference than this are not compared");
    visit("reference_neighbors", self.reference_neighbors, Range{3, 64},
          "number of points of a reference cloud to which its local plane is fitted");
  }
};

}  // namespace malus
