#pragma once

#include <complex>
#include <cstdint>
#include <optional>
#include <vector>

#include "malus/core/image.h"
#include "malus/evidence/reduced_view_internal.h"

namespace malus {

/// How a prior would have to be moved in the image to lie where the image shows it: a turn and a change of size about
/// the center of the prior's pixels, then a shift. In pixels of one SceneView; the turn is clockwise as displayed.
struct Similarity {
  double du = 0, dv = 0, turn_rad = 0, log_scale = 0;
};

/// The prior's pixels that are compared with the image, in row order.
struct TemplatePixels {
  std::vector<float> u, v;
  std::vector<std::uint16_t> block;  ///< of 10 × 10 blocks of the box about them
  double center_u = 0, center_v = 0;
  double radius = 0;  ///< root mean square distance from the center
  double extent = 0;  ///< the larger side of the box about 96 % of them

  std::size_t count() const { return u.size(); }
  static constexpr std::size_t blocks = 100;
};

TemplatePixels template_pixels(const Mask& pixels);

/// Sum over its standard deviation, if the parts are independent and of mean zero.
double sum_in_sigmas(const std::vector<double>& parts);

/// Something that both the prior and the image show, so that their correlation is highest where the prior lies right.
class AlignmentCue {
 public:
  using Value = std::complex<float>;

  /// values and weights: of the template's pixels. image_values are multiplied by image_weights already. turns: how
  /// often the values turn while the prior turns once (4 for exp(4i azimuth)); 0 = real values, which must agree in
  /// their sign, too.
  AlignmentCue(std::vector<Value> values, std::vector<float> weights, const Image<float>& image_real,
               const Image<float>& image_imaginary, const Image<float>& image_weights, int turns);

  /// Whether the template's values differ from each other at all.
  bool has_template() const;

  /// Squared correlation of the template, moved, with the image.
  double correlation2(const TemplatePixels& pixels, const Similarity& moved) const;

  /// Spread of the image's values over that of the template's, moved.
  double contrast(const TemplatePixels& pixels, const Similarity& moved) const;

  /// How much more of the image the template explains in one place than in another: the difference of the squared
  /// correlations, by blocks.
  std::vector<double> gain_by_block(const TemplatePixels& pixels, const Similarity& from, const Similarity& to) const;
  /// How much it explains at all, in standard deviations.
  double signal_sigmas(const TemplatePixels& pixels, const Similarity& at) const;
  /// Number of independent pixels that would scatter as the blocks do in what the template leaves unexplained.
  double independent_pixels(const TemplatePixels& pixels, const Similarity& at) const;

 private:
  struct Samples;
  struct Moments;
  Samples sample(const TemplatePixels& pixels, const Similarity& moved) const;
  Moments moments(const Samples& samples) const;
  std::vector<double> explained_by_block(const TemplatePixels& pixels, const Similarity& at) const;

  std::vector<Value> values_;
  std::vector<float> weights_;
  Image<float> image_;  ///< real part, imaginary part, weight
  int turns_;
};

/// Colors of the prior against the image's brightness.
AlignmentCue color_cue(const PriorView& prior, const SceneView& scene, const Mask& pixels);

/// Azimuths of the prior against phases, exp(4i ·) of both, which is the same for diffuse and specular reflection.
AlignmentCue phase_cue(const PriorView& prior, const SceneView& scene, const Mask& pixels, const Pinhole& camera);

/// Where the prior bends against where the image changes; none for a prior that bends alike everywhere, as a plane or a
/// sphere does.
std::optional<AlignmentCue> edge_cue(const PriorView& prior, const SceneView& scene, const Mask& pixels);

}  // namespace malus
