#include "malus/polarization/pixel_curves_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

TEST(PixelCurves, ChosenPixelsMustLieInTheImages) {
  PolarizationState state;
  state.i_un = Image<float>({4, 3});
  std::vector<Image<float>> images(3, Image<float>({4, 3}));
  images[2](3, 2) = 0.5F;
  const std::vector<double> angles_rad{0, 1, 2};
  const std::vector<PixelCurve> curves = pixel_curves(state, images, angles_rad, {{3, 2}, {0, 1}});
  ASSERT_EQ(curves.size(), 2U);
  EXPECT_EQ(curves[0].u, 3);
  EXPECT_EQ(curves[0].v, 2);
  EXPECT_EQ(curves[0].intensities, (std::vector<double>{0, 0, 0.5}));
  // Pixels outside can occur with RAW files, because their size is not known when the station file is read.
  for (const std::array<double, 2> outside : {std::array{4.0, 0.0}, {0.0, 3.0}, {-1.0, 0.0}}) {
    expect_error(
        ErrorCode::input,
        [&] {
          pixel_curves(state, images, angles_rad, {{0, 0}, outside});
        },
        "curve_pixels", "4 x 3");
  }
}

TEST(PixelCurves, AreThoseOfASmallObjectInALargeImage) {
  const Size size{700, 300};
  PolarizationState state;
  state.i_un = state.rho = Image<float>(size);
  state.valid = Mask(size);
  state.valid(1, 0) = state.valid(2, 0) = static_cast<std::uint8_t>(PixelState::valid);
  state.rho(2, 0) = 0.1F;
  const std::vector<Image<float>> images(3, Image<float>(size));
  const std::vector<PixelCurve> curves = pixel_curves(state, images, {0, 1, 2}, {});
  ASSERT_EQ(curves.size(), 4U);
  EXPECT_EQ(curves.front().u, 1);
  EXPECT_EQ(curves.front().v, 0);
}

}  // namespace
}  // namespace malus
