#include <algorithm>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "malus/capture/affine_displacement_internal.h"
#include "malus/capture/registration_internal.h"
#include "malus/capture/registration_level_internal.h"
#include "malus/capture/registration_verdict_internal.h"
#include "malus/core/opencv_mat_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/core/parallel_internal.h"

namespace malus {
namespace {

constexpr int smallest_side_px = 48;
constexpr int coarsest_side_px = 110;
constexpr double coarse_tolerance_px = 0.01, fine_tolerance_px = 1e-3;

Image<float> half_size(const Image<float>& image) {
  auto half = Image<float>::uninitialized({(image.width() + 1) / 2, (image.height() + 1) / 2});
  cv::Mat out = as_mat(half);
  cv::pyrDown(as_mat(image), out, out.size());
  return half;
}

/// Half-size images, coarser and coarser; level 0 is half the input.
using Pyramid = std::vector<std::vector<Image<float>>>;

Pyramid coarser_levels(const std::vector<Image<float>>& images, const Context& context) {
  Pyramid pyramid;
  const std::vector<Image<float>>* finer = &images;
  while (std::min((*finer)[0].width(), (*finer)[0].height()) >= 2 * coarsest_side_px) {
    std::vector<Image<float>> halves(images.size());
    parallel_for(context, images.size(), 1, [&](std::size_t k, std::size_t) { halves[k] = half_size((*finer)[k]); });
    pyramid.push_back(std::move(halves));
    finer = &pyramid.back();
  }
  return pyramid;
}

}  // namespace

std::vector<ImageRegistration> register_images(const std::vector<Image<float>>& images, const NoiseModel& noise,
                                               const RegistrationOptions& options, const Context& context) {
  validate_fields(options, "capture");
  std::vector<ImageRegistration> results(images.size());
  if (images.empty()) return results;
  const Size size = images[0].size();
  for (std::size_t k = 0; k < images.size(); ++k) require_size(images[k], size, "image " + std::to_string(k));
  results[0].status = RegistrationStatus::ok;
  if (images.size() == 1) return results;
  if (std::min(size.width, size.height) < smallest_side_px) {
    for (std::size_t k = 1; k < images.size(); ++k) {
      results[k].status = RegistrationStatus::no_texture;
      results[k].message = "the image is " + to_string(size) + " pixels, too small to register";
    }
    return results;
  }

  const OpenCvThreads one_thread(1);  // OpenCV is called from threads of our own
  Pyramid pyramid = coarser_levels(images, context);
  std::vector<Affine> maps(images.size(), identity_affine());
  RegistrationLevel::Assessment assessment;
  double last_step_px = 0;
  for (std::size_t coarser = pyramid.size() + 1; coarser-- > 0;) {
    const bool coarsest = coarser == pyramid.size(), finest = coarser == 0;
    context.progress("capture", 1 - static_cast<double>(coarser + 1) / static_cast<double>(pyramid.size() + 1),
                     "registration");
    const bool has_quarters = coarser + 2 <= pyramid.size();
    // The finest level needs the most memory. It uses only the images and their quarters, so half-size images are
    // freed.
    if (finest && !coarsest) pyramid.front().clear();
    const RegistrationLevel level(finest ? images : pyramid[coarser - 1],
                                  has_quarters ? pyramid[coarser + 1] : std::vector<Image<float>>{}, noise, options,
                                  context);
    for (std::size_t k = 1; coarsest && k < images.size(); ++k) maps[k] = level.phase_correlation(k);
    last_step_px = level.solve(maps, finest ? fine_tolerance_px : coarse_tolerance_px);
    if (finest) {
      assessment = level.assess(maps);
    } else {
      for (Affine& map : maps) map.col(2) *= 2;
    }
  }
  for (std::size_t k = 1; k < images.size(); ++k) {
    results[k].image_from_base = maps[k];
    results[k].displacement_px = affine_distance_px(maps[k], identity_affine(), size);
    results[k].rms_px = assessment.rms_px[k];
    judge_registration(results[k],
                       {assessment.texture, assessment.unmoved_texture, assessment.similarity[k], last_step_px}, size,
                       options);
  }
  return results;
}

}  // namespace malus
