#pragma once

#include <array>
#include <string_view>

#include "malus/core/fields.h"

namespace malus {

/// How the surface is moved onto a reference before distances are taken.
enum class Alignment { none, rigid, similarity };
constexpr auto names_of(Alignment) {
  return std::to_array<std::string_view>({"none", "rigid", "similarity"});
}

struct AssessOptions {
  bool polarization_height = true;
  double detail_sigma_px = 8;
  int histogram_bins = 50;
  double histogram_range_gsd = 1;
  double sigma_limit_gsd = 1;
  double profile_step_px = 1;
  Alignment alignment = Alignment::none;
  double max_distance_gsd = 50;
  int reference_neighbors = 12;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("polarization_height", self.polarization_height, any_value,
          "solve for zenith and height of the polarization alone, to show beside the surface; grid fusion needs them");
    visit("detail_sigma_px", self.detail_sigma_px, Range{0.5, 100},
          "Gaussian that separates detail (what it removes) from low frequencies");
    visit("histogram_bins", self.histogram_bins, Range{2, 10000}, "bins of the distance histograms");
    visit("histogram_range_gsd", self.histogram_range_gsd, Range{1e-6, 1e6}, "histograms span plus and minus this");
    visit("sigma_limit_gsd", self.sigma_limit_gsd, Range{1e-6, 1e6},
          "pixels with a larger standard deviation of depth count as uncertain");
    visit("profile_step_px", self.profile_step_px, Range{0.05, 100}, "largest distance of profile samples");
    visit("alignment", self.alignment, any_value, "move the surface onto the reference first (ICP)");
    visit("max_distance_gsd", self.max_distance_gsd, Range{1e-3, 1e9},
          "points farther from the reference than this are not compared");
    visit("reference_neighbors", self.reference_neighbors, Range{3, 64},
          "points of a reference cloud that make its local plane");
  }
};

}  // namespace malus
