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
    visit("grid_px", self.grid_px, Range{1, 4096}, "distance between the grid's nodes, in px");
    visit("sigma_nodes", self.sigma_nodes, Range{0, 1000},
          "standard deviation of the Gaussian that smooths the grid, in nodes");
    visit("unit_scaling", self.unit_scaling, any_value,
          "scale both surfaces to 0 … 1 before combining them, as printed in the paper; loses the metric relation of "
          "their scales");
  }
};

struct OptimizeOptions {
  bool enabled = false;
  double phase_weight = 1;    ///< of the phase (Eq 9) at the unit normal
  double shading_weight = 1;  ///< of the shading (Eq 11), divided by the light's strength
  double zenith_weight = 1;   ///< of the cosine of the zenith (Eq 7 or Eq 8)
  double prior_weight = 0.15;
  int iterations = 15;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("enabled", self.enabled, any_value, "grid fusion: optimize the fused surface by all equations together");
    visit("phase_weight", self.phase_weight, not_negative,
          "weight of the azimuth (direction of slope) that the phase of polarization gives; 0 = ignored");
    visit("shading_weight", self.shading_weight, not_negative,
          "weight of the shading equation, by which brightness gives the slope; 0 = ignored");
    visit("zenith_weight", self.zenith_weight, not_negative,
          "weight of the zenith (steepness) that the degree of polarization gives; 0 = ignored");
    visit("prior_weight", self.prior_weight, not_negative,
          "weight of the difference from the prior, averaged over each cell of the grid, in 1 / GSD per pixel; larger "
          "stays closer to the prior");
    visit("iterations", self.iterations, Range{1, 1000}, "largest number of solver steps in each tile");
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
          "number of rounds, of one step each, if a map of the surroundings is fitted: map and surface converge slowly "
          "together");
    visit("fine_iterations", self.fine_iterations, Range{1, 50},
          "rounds at full resolution after those at half the resolution; with a map of the surroundings one more");
    visit(
        "coarsest_px", self.coarsest_px, Range{16, 1e9},
        "if the search runs or a map of the surroundings is fitted, objects are first refined at half the resolution, "
        "before that at half of it, and so on, as long as the square root of their number of pixels is at least this "
        "(with a map 1.5 times this), in px");
    visit("more_iterations", self.more_iterations, Range{0, 50},
          "largest number of further rounds at the end, while the surface still moves by more than 0.5 GSD");
    visit("steps", self.steps, Range{1, 50}, "Gauss-Newton steps in each round; the first two rounds take one");
    visit("tile_px", self.tile_px, Range{64, 4096}, "largest side of a tile without its margins, in px");
    visit("margin_px", self.margin_px, Range{16, 512}, "margin by which a tile overlaps its neighbors, in px");
    visit("strip_megapixels", self.strip_megapixels, Range{0.001, 1e6},
          "the image is processed in strips of whole rows of tiles of about this many megapixels; larger takes more "
          "memory");
    visit("robust_scale", self.robust_scale, Range{0.1, 100},
          "residual of the polarization, in standard deviations, at which a pixel has half its weight");
    visit("graduation", self.graduation, Range{1, 100},
          "robust_scale is this many times larger for specular regions in the first round; the factor is halved every "
          "round");
    visit("relative_error", self.relative_error, Range{0, 0.1},
          "standard deviation of the reflection model's error, as a share of s0 (the intensity)");
    visit("slope_error", self.slope_error, Range{0, 1},
          "standard deviation of the reflection model's error, expressed as an error of the slope");
    visit("prior_weight", self.prior_weight, not_negative,
          "how strongly the surface is held to the prior where the prior is uncertain: larger stays closer to it, "
          "smaller follows the polarization more (weight of the mean of 8 x 8 pixels, in 1 / GSD)");
    visit("good_prior_weight", self.good_prior_weight, not_negative,
          "weight of the prior's mean over a block of 8 x 8 pixels, in 1 / GSD, where the prior's sigma is small");
    visit("prior_robust_gsd", self.prior_robust_gsd, Range{0.01, 1000},
          "distance from the prior, in GSD, at which the prior has half its weight");
    visit("albedo_weight", self.albedo_weight, not_negative,
          "weight of albedo differences between neighboring diffuse pixels, up to 2.5 times larger if albedo varies "
          "little; larger explains brightness by shape instead of albedo");
    visit("albedo_contrast", self.albedo_contrast, Range{1e-4, 10},
          "difference of ln albedo between neighboring pixels at which albedo_weight is halved");
    visit("smoothness", self.smoothness, not_negative,
          "weight of the second differences of the change from the prior, times the share of noise in the variance of "
          "the polarization; larger is smoother");
    visit("search_sharpening", self.search_sharpening, Range{-10, 10},
          "the search's second start is the prior plus this many times its own detail finer than 8 px; 0 = the prior "
          "itself, -1 = the prior without that detail");
    visit("search", self.search, any_value,
          "if much of the object is specular: solve again from a second start, and keep the better solution in each "
          "region");
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
          "prior's slopes; with a map of the surroundings, fixed limits apply instead");
    visit("explained_enough", self.explained_enough, Range{-1, 1},
          "the refined surface is kept where the model explains at least this share of the polarization at the prior's "
          "slopes; between explained_least and this, both are blended");
    visit("anchor", self.anchor, not_negative,
          "waves longer than a Gaussian of this number times the square root of (noise of the prior's points in GSD "
          "times their spacing in px), in px, are the prior's; larger: polarization also decides longer waves; 0 = no "
          "such limit");
  }
};

}  // namespace malus
