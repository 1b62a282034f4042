#pragma once

#include <complex>
#include <cstdint>
#include <optional>
#include <vector>

#include "malus/core/image.h"
#include "malus/evidence/reduced_view_internal.h"

namespace malus {

/// The motion of a prior in the image that puts it where the image shows it: a turn and a change of size about the
/// center of the prior's pixels, then a shift. In pixels of one SceneView; the turn is clockwise as displayed.
struct Similarity {
  double du = 0, dv = 0, turn_rad = 0, log_scale = 0;
};

/// The prior's pixels that are compared with the image, in row order.
struct TemplatePixels {
  std::vector<float> u, v;
  std::vector<std::uint16_t> block;  ///< index of the pixel's block; 10 × 10 blocks divide the pixels' bounding box
  double center_u = 0, center_v = 0;
  double radius = 0;  ///< root mean square distance from the center
  double extent = 0;  ///< the larger side of the box about 96 % of the pixels

  std::size_t count() const { return u.size(); }
  static constexpr std::size_t blocks = 100;
};

TemplatePixels template_pixels(const Mask& pixels);

/// Sum divided by its standard deviation, which is that of independent parts of mean zero.
double sum_in_sigmas(const std::vector<double>& parts);

/// A property that both the prior and the image show; their correlation is highest where the prior lies right.
class AlignmentCue {
 public:
  using Value = std::complex<float>;

  /// values and weights: of the template's pixels. image_real and image_imaginary are multiplied by image_weights
  /// already. turns: number of times the values turn while the prior turns once (4 for exp(4i azimuth)); 0 = real
  /// values, whose sign must agree, too.
  AlignmentCue(std::vector<Value> values, std::vector<float> weights, const Image<float>& image_real,
               const Image<float>& image_imaginary, const Image<float>& image_weights, int turns);

  /// Squared correlation of the moved template with the image.
  double correlation2(const TemplatePixels& pixels, const Similarity& moved) const;

  /// Spread of the image's values divided by that of the moved template's.
  double contrast(const TemplatePixels& pixels, const Similarity& moved) const;

  /// How much more of the image the template explains at `to` than at `from`: the difference of the squared
  /// correlations, by blocks.
  std::vector<double> gain_by_block(const TemplatePixels& pixels, const Similarity& from, const Similarity& to) const;
  /// How much of the image the template explains at `at`, in standard deviations.
  double signal_sigmas(const TemplatePixels& pixels, const Similarity& at) const;
  /// Effective number of independent pixels, by how the residuals after the template's fit scatter between the blocks.
  double independent_pixels(const TemplatePixels& pixels, const Similarity& at) const;

 private:
  struct Samples;
  struct Moments;
  /// Factor of the template's values when the prior is moved.
  Value turn_of(const Similarity& moved) const;
  /// Calls take(i, real part, imaginary part, weight) for every pixel of the template that lies in the image; `real`:
  /// without imaginary parts.
  template <bool real, class Take>
  void for_each_sample(const TemplatePixels& pixels, const Similarity& moved, Take&& take) const;
  Samples sample(const TemplatePixels& pixels, const Similarity& moved) const;
  template <bool real>
  Moments summed(const TemplatePixels& pixels, const Similarity& moved) const;
  Moments moments(const TemplatePixels& pixels, const Similarity& moved) const;
  std::vector<double> explained_by_block(const TemplatePixels& pixels, const Similarity& at) const;

  std::vector<Value> values_;
  std::vector<float> weights_;
  Image<float> image_;  ///< real part, imaginary part, weight
  int turns_;
};

/// Compares colors of the prior with the image's brightness. None for a prior without colors or of a single one.
std::optional<AlignmentCue> color_cue(const PriorView& prior, const SceneView& scene, const Mask& pixels);

/// Compares azimuths of the prior with phases: exp(4i ·) of both, which is the same for diffuse and specular
/// reflection.
AlignmentCue phase_cue(const PriorView& prior, const SceneView& scene, const Mask& pixels);

/// Compares where the prior bends with where the image's brightness changes. None for a prior of uniform bending, such
/// as a plane or a sphere.
std::optional<AlignmentCue> edge_cue(const PriorView& prior, const SceneView& scene, const Mask& pixels);

}  // namespace malus
