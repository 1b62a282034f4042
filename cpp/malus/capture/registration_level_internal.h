#pragma once

#include <vector>

#include "malus/capture/affine_displacement_internal.h"
#include "malus/capture/compared_bands_internal.h"

namespace malus {

/// One level of the pyramid: the bands of all images, and the steps towards their maps.
class RegistrationLevel {
 public:
  /// quarters: the images two levels up the pyramid, or nothing.
  RegistrationLevel(const std::vector<Image<float>>& images, const std::vector<Image<float>>& quarters,
                    const NoiseModel& noise, const RegistrationOptions& options, const Context& context)
      : options_(options),
        context_(context),
        size_(images[0].size()),
        compared_(compared_bands(images, quarters, noise, options, context)) {}

  /// Gauss–Newton from the given maps; returns the last step's largest displacement [px].
  double solve(std::vector<Affine>& maps, double tolerance_px) const;

  /// Translation of image k by phase correlation, if it correlates better with the first image than no translation
  /// does.
  Affine phase_correlation(std::size_t k) const;

  /// Uncertainty, texture and similarity at the given maps; RegistrationFigures explains them.
  struct Assessment {
    std::vector<double> rms_px, similarity;
    double texture = 0, unmoved_texture = 0;
  };
  Assessment assess(const std::vector<Affine>& maps) const;

 private:
  double correlation(const Image<float>& image, const Affine& map) const;
  /// One step of Gauss–Newton; returns its largest displacement [px].
  double step(std::vector<Affine>& maps) const;

  const RegistrationOptions& options_;
  const Context& context_;
  Size size_;
  ComparedBands compared_;
};

}  // namespace malus
