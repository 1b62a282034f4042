#include <gtest/gtest.h>

#include "malus/fusion/refine_internal.h"
#include "malus/lighting/light_internal.h"
#include "malus/polarization/reflection_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

/// Programs that embed the library call the steps' functions themselves, and get their errors.
TEST(Options, ErrorsOfAStepNameTheSectionThatIsListed) {
  LightOptions light;
  light.iterations = 0;
  expect_error(
      ErrorCode::input, [&] { estimate_light({}, {}, {}, nullptr, light, {}); }, "option light.iterations");
  ReflectionOptions reflection;
  reflection.region_px = 0;
  expect_error(
      ErrorCode::input, [&] { map_reflection({}, nullptr, nullptr, nullptr, reflection, {}); },
      "option reflection.region_px");
  RefineOptions refinement;
  refinement.iterations = 0;
  expect_error(
      ErrorCode::input, [&] { refine({}, {}, {}, refinement, {}); }, "option refine.iterations");
}

}  // namespace
}  // namespace malus
