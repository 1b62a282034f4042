#include <gtest/gtest.h>

#include <limits>

#include "malus/fusion/refinement_weights_internal.h"
#include "synthetic_station.h"

namespace malus {
namespace {

TEST(Residuals, OfASmallObjectInALargeImageAreSummarized) {
  constexpr float none = std::numeric_limits<float>::quiet_NaN();
  constexpr int u = 24, v = 7;  // not among the samples of a whole image of this size
  const Size size{2500, 2000};
  Mask usable(size);
  usable(u, v) = 255;
  const Size row{size.width, 1};
  PixelResiduals residuals{Image<float>(row, 1, none), Image<float>(row, 1, none)};
  residuals.squared(u, 0) = 4;
  ResidualSummary summary(usable);
  summary.add(residuals, {0, 1}, v);
  EXPECT_EQ(summary.quality().median_residual, 2);
}

TEST(PriorBlocks, HoldAHoleAtHalfTheResolutionAsStronglyAsAtFull) {
  const SyntheticStation station = make_station({});
  const RefinementImage image = make_image(station.state, station.prior, Context{});
  RefinementField field = image.part(image.everything(), Context{});
  field.kind.fill(Reflection::diffuse);
  const auto weight = [&](float sigma_gsd, int binning) {
    field.prior_sigma.fill(sigma_gsd / static_cast<float>(binning));
    WeightOptions options;
    options.binning = binning;
    options.prior_weight *= binning;
    options.good_prior_weight *= binning;
    update_weights(field, options, Context{});
    return field.block_weight(3, 3);
  };
  // Distances are half as many of the larger GSD, so their squares need four times the weight.
  for (const float sigma_gsd : {0.5F, 1.5F, 3.0F, 10.0F})
    EXPECT_NEAR(weight(sigma_gsd, 2) / weight(sigma_gsd, 1), 4, 1e-3) << sigma_gsd;
}

}  // namespace
}  // namespace malus
