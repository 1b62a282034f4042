#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <type_traits>

#include "malus/core/robust_spread_internal.h"
#include "malus/fusion/same_normals_internal.h"
#include "synthetic_station.h"

namespace malus {
namespace {

/// An image whose surface lies at this height [GSD] above a plane that faces the camera.
template <class Height>
RefinementImage surface(const SyntheticStation& station, const Height& height) {
  RefinementImage image = make_image(station.state, station.prior, Context{});
  for (int v = 0; v < image.size().height; ++v) {
    for (int u = 0; u < image.size().width; ++u)
      image.x(u, v) = height(u - 0.5 * image.size().width, v - 0.5 * image.size().height);
  }
  return image;
}

/// The same object in the corner of an image of this size.
RefinementImage in_large_image(const RefinementImage& small, Size size) {
  const auto padded = [&](const auto& part) {
    std::decay_t<decltype(part)> whole(size);
    for (int v = 0; v < part.height(); ++v) std::copy_n(part.row(v), part.width(), whole.row(v));
    return whole;
  };
  RefinementImage image = small;
  image.pixels = padded(small.pixels);
  image.usable = padded(small.usable);
  image.object = padded(small.object);
  image.x = padded(small.x);
  return image;
}

TEST(SameNormals, AreNearEachOtherOnABowlAndSpreadOverARelief) {
  SyntheticOptions scene;
  scene.size = {160, 128};
  const SyntheticStation station = make_station(scene);
  const auto bowl = [](double x, double y) { return 0.004 * (x * x + y * y); };
  const auto relief = [](double x, double y) { return 1.5 * std::sin(0.3 * x) * std::cos(0.3 * y); };
  const double on_bowl = distance_of_same_normals(surface(station, bowl));
  // A cell spans 0.1 of a component of the normal: 12 px where the normal changes by 0.008 per pixel.
  EXPECT_NEAR(on_bowl, std::hypot(12.5, 12.5) / 4 * deviation_per_median, 1.5);
  // Same normals spread evenly over 160 columns and 128 rows: half of them lie within a quarter of the size (40 and
  // 32 px) of the center.
  EXPECT_NEAR(distance_of_same_normals(surface(station, relief)), std::hypot(40, 32) * deviation_per_median, 8);
}

TEST(SameNormals, DistanceIsRobustAgainstOneStrayFacet) {
  SyntheticOptions scene;
  scene.size = {160, 128};
  const SyntheticStation station = make_station(scene);
  const auto bowl = [](double x, double y) { return 0.004 * (x * x + y * y); };
  const auto chipped = [&](double x, double y) { return x > 50 && y > 40 ? 0 : bowl(x, y); };
  EXPECT_NEAR(distance_of_same_normals(surface(station, chipped)), distance_of_same_normals(surface(station, bowl)), 2);
}

TEST(SameNormals, OfASmallObjectDoNotDependOnTheImageAroundIt) {
  SyntheticOptions scene;
  scene.size = {40, 40};
  const SyntheticStation station = make_station(scene);
  const RefinementImage alone =
      surface(station, [](double x, double y) { return 1.5 * std::sin(0.3 * x) * std::cos(0.3 * y); });
  EXPECT_EQ(distance_of_same_normals(in_large_image(alone, {4000, 2000})), distance_of_same_normals(alone));
}

TEST(SameNormals, DistanceIsAtLeastOnePixel) {
  SyntheticOptions scene;
  scene.size = {12, 10};
  const SyntheticStation station = make_station(scene);
  EXPECT_EQ(distance_of_same_normals(surface(station, [](double x, double y) { return 0.1 * (x * x + y * y); })), 1);
}

}  // namespace
}  // namespace malus
