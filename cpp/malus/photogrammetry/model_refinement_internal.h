#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/io/colmap_model_internal.h"
#include "malus/options/prior_options.h"
#include "malus/photogrammetry/bundle_adjustment_internal.h"

namespace malus {

/// What a refinement did to a model.
struct ModelRefinement {
  AdjustmentStatus status = AdjustmentStatus::not_run;
  std::size_t points = 0;   ///< matched in two or more images
  std::size_t matches = 0;  ///< of their windows
  double matches_a_point = 0;
  double sigma_px = 0;     ///< median standard deviation of a match
  double keypoint_px = 0;  ///< robust standard deviation of the keypoints that were there before
  BundleReport adjustment;
  /// Standard deviations of the parameters of each lens that was adjusted, by camera id.
  std::map<std::uint32_t, std::vector<double>> lens_sigma;
};

/// Measures the points of a COLMAP model anew by least-squares matching and adjusts lenses, poses and points to that.
///
/// Keypoints are located to a few tenths of a pixel. What turns a camera about a flat object shows in its image by
/// hundredths only, so the poses gain as the measurement does. Points are matched from the image `preferred` where it
/// sees them, else from the one of their images that faces them most; planes through their neighbors give the windows'
/// shape. Keypoints of points or images where that does not succeed remain with their own standard deviation.
///
/// pictures: intensity in [0, 1] of every image of the model, by name; moved here, they are in memory once, their
/// pyramids take a third more. freedom: what of each camera's lens is adjusted, by camera id; those absent are fixed.
/// Points keep their ids and tracks; their error is anew.
///
/// Throws an input error for a picture that is missing or has another size than its camera.
ModelRefinement refine_model(ColmapModel& model, std::map<std::string, Image<float>> pictures,
                             const std::string& preferred, const std::map<std::uint32_t, LensFreedom>& freedom,
                             const PhotosOptions& options, const Context& context);

}  // namespace malus
