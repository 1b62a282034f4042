#pragma once

#include <array>
#include <string_view>

#include "malus/core/fields.h"

namespace malus {

/// Which fusion makes the result.
enum class Fusion {
  grid,     ///< the paper's transfer of polarization detail onto the prior (Eq 14 to 16)
  refined,  ///< nonlinear least squares on log depth
};
constexpr auto names_of(Fusion) {
  return std::to_array<std::string_view>({"grid", "refined"});
}

struct GridFusionOptions {
  int grid_px = 4;
  double sigma_nodes = 1;
  bool unit_scaling = false;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("grid_px", self.grid_px, Range{1, 4096}, "distance of the grid's nodes");
    visit("sigma_nodes", self.sigma_nodes, Range{0, 1000}, "Gaussian on the grid, standard deviation in nodes");
    visit("unit_scaling", self.unit_scaling, any_value,
          "scale both surfaces to 0 … 1 before combining them, as printed; loses the metric relation of their scales");
  }
};

struct OptimizeOptions {
  bool enabled = false;
  double phase_weight = 1;    ///< of Eq 9, for the unit normal
  double shading_weight = 1;  ///< of Eq 11, in shares of the light
  double zenith_weight = 1;   ///< of the cosine of the zenith by Eq 7 or Eq 8
  double prior_weight = 0.15;
  int iterations = 15;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("enabled", self.enabled, any_value, "grid fusion: optimize the fused surface by all equations together");
    visit("phase_weight", self.phase_weight, not_negative,
          "how much the directions of slopes count that the polarization shows");
    visit("shading_weight", self.shading_weight, not_negative, "how much the slopes count that the brightness shows");
    visit("zenith_weight", self.zenith_weight, not_negative,
          "how much the steepness counts that the degree of polarization shows");
    visit("prior_weight", self.prior_weight, not_negative,
          "how much the difference to the prior counts, mean over a cell of the grid, in GSD");
    visit("iterations", self.iterations, Range{1, 1000}, "largest number of steps in a tile");
  }
};

struct RefineOptions {
  int iterations = 2;
  int surroundings_iterations = 10;
  int fine_iterations = 2;
  int more_iterations = 3;
  int steps = 2;
  double coarsest_px = 100;
  int tile_px = 384;
  int margin_px = 32;
  double strip_megapixels = 6;
  double robust_scale = 2.5;
  double graduation = 4;
  double relative_error = 0.002;
  double slope_error = 0.03;
  double prior_weight = 5;
  double good_prior_weight = 12;
  double prior_robust_gsd = 2;
  double albedo_weight = 10;
  double albedo_contrast = 0.04;
  double smoothness = 3;
  double search_sharpening = 2.5;
  bool search = true;
  bool environment = true;
  bool lobe = true;
  bool regional_weights = true;
  bool surroundings = true;
  bool correct_index = true;
  bool evidence = true;
  double explained_least = 0.35;
  double explained_enough = 0.55;
  double anchor = 8;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("iterations", self.iterations, Range{1, 50},
          "rounds; each fits the reflection, weighs the residuals and solves for the surface");
    visit("surroundings_iterations", self.surroundings_iterations, Range{1, 50},
          "rounds where a map of the surroundings is fitted, of one step each: map and surface find each other slowly");
    visit("fine_iterations", self.fine_iterations, Range{1, 50},
          "rounds at full resolution after those at half the resolution");
    visit("coarsest_px", self.coarsest_px, Range{16, 1e9},
          "where a search is worth it, objects are refined at half the resolution first, down to this width and "
          "height, in px");
    visit("more_iterations", self.more_iterations, Range{0, 50},
          "largest number of further rounds at the end, while the surface still moves by more than 0.5 GSD");
    visit("steps", self.steps, Range{1, 50}, "Gauss-Newton steps in each round; the first two rounds take one");
    visit("tile_px", self.tile_px, Range{64, 4096}, "largest side of a tile without its margins, in px");
    visit("margin_px", self.margin_px, Range{16, 512}, "margin by which a tile overlaps its neighbors, in px");
    visit("strip_megapixels", self.strip_megapixels, Range{0.001, 1e6},
          "size of the strips of whole rows of tiles that are worked on one after the other; memory grows with it");
    visit("robust_scale", self.robust_scale, Range{0.1, 100},
          "residual of the polarization, in standard deviations, at which a pixel has half its weight");
    visit("graduation", self.graduation, Range{1, 100},
          "robust_scale is this many times larger for specular regions in the first round; the factor is halved every "
          "round");
    visit("relative_error", self.relative_error, Range{0, 0.1}, "error of the reflection model as a share of s0");
    visit("slope_error", self.slope_error, Range{0, 1}, "error of the reflection model, as an error of the slope");
    visit("prior_weight", self.prior_weight, not_negative,
          "how strongly the surface is held to the coarse one where that is uncertain: more stays closer to it, less "
          "believes the polarization more (weight of the mean of 8 x 8 pixels, in 1 / GSD)");
    visit("good_prior_weight", self.good_prior_weight, not_negative,
          "weight of the prior's mean over a block of 8 x 8 pixels, in 1 / GSD, where the prior's sigma is small");
    visit("prior_robust_gsd", self.prior_robust_gsd, Range{0.01, 1000},
          "distance from the prior, in GSD, at which the prior has half its weight");
    visit("albedo_weight", self.albedo_weight, not_negative,
          "weight of changes of albedo in diffuse regions; up to 2.5 times that where albedo varies little");
    visit("albedo_contrast", self.albedo_contrast, Range{1e-4, 10},
          "step of ln albedo between neighboring pixels at which it has half its weight");
    visit(
        "smoothness", self.smoothness, not_negative,
        "weight of the second differences of the change to the prior, where all that is wrong with the polarization is "
        "noise; less by the share of other errors");
    visit("search_sharpening", self.search_sharpening, Range{-10, 10},
          "factor on the prior's detail that the search for a better minimum starts with");
    visit("search", self.search, any_value,
          "where regions are specular: solve from a second start, too, and keep the better regions of both");
    visit("environment", self.environment, any_value,
          "let diffuse regions mirror smooth surroundings, whose light is fitted");
    visit("lobe", self.lobe, any_value, "let diffuse regions have the highlight of one small source, which is fitted");
    visit("regional_weights", self.regional_weights, any_value,
          "give less weight to regions that fit badly, such as cast shadows");
    visit("surroundings", self.surroundings, any_value,
          "fit a map of the surroundings that a matte or glossy object mirrors, where that explains more of the "
          "polarization");
    visit("correct_index", self.correct_index, any_value,
          "replace a refractive index that the polarization clearly contradicts");
    visit("evidence", self.evidence, any_value,
          "keep the prior's surface where the reflection model does not explain the polarization");
    visit("explained_least", self.explained_least, Range{-1, 1},
          "the prior's surface is kept where the model explains no more than this share of the polarization at the "
          "prior's slopes; with a map of the surroundings other limits hold");
    visit("explained_enough", self.explained_enough, Range{-1, 1},
          "the refined surface is kept where the model explains at least this share of the polarization at the prior's "
          "slopes");
    visit("anchor", self.anchor, not_negative,
          "the prior's low frequencies are kept beyond this times the square root of its points' noise (GSD) times "
          "their distance (px), in px; 0 = not");
  }
};

}  // namespace malus
