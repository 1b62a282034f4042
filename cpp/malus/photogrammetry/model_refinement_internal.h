#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/field_list.h"
#include "malus/core/image.h"
#include "malus/io/colmap_model_internal.h"
#include "malus/options/prior_options.h"
#include "malus/photogrammetry/bundle_adjustment_internal.h"

namespace malus {

/// Result of a refinement.
struct ModelRefinement {
  AdjustmentStatus status = AdjustmentStatus::not_run;
  std::size_t points = 0;   ///< points matched in two or more images
  std::size_t matches = 0;  ///< matched windows of these points
  double matches_a_point = 0;
  double sigma_px = 0;                        ///< median standard deviation of a match
  double keypoint_px = 0;                     ///< robust standard deviation of the model's original keypoints
  std::vector<std::string> with_few_matches;  ///< images that follow the others by their keypoints, or stay
  BundleReport adjustment;
  /// Standard deviations of the parameters of each lens that was adjusted, by camera id.
  std::map<std::uint32_t, std::vector<double>> lens_sigma;

  MALUS_FIELDS(status, points, matches, matches_a_point, sigma_px, keypoint_px)
};

/// Measures the points of a COLMAP model again by least-squares matching and adjusts lenses, poses and points to the
/// new measurements.
///
/// Keypoints are located to a few tenths of a pixel. Small turns of a camera about a flat object move its image by
/// hundredths of a pixel only, so better measurements give better poses. The reference window of a point is in the
/// image `preferred` if it sees the point, else in the image that faces the point most. Planes through neighboring
/// points give the windows' shape. Points without a match, and images with few of them, keep their keypoints, with the
/// keypoints' standard deviation; with fewer than three keypoints of the model's points an image stays where it is.
///
/// pictures: intensity in [0, 1] of every image of the model, by name. If moved here, they are in memory once; their
/// pyramids take a third more. freedom: which parameters of each camera's lens are adjusted, by camera id; absent
/// lenses are fixed. Points keep their ids and tracks; their errors are updated.
///
/// Throws an input error for a picture that is missing or has another size than its camera.
ModelRefinement refine_model(ColmapModel& model, std::map<std::string, Image<float>> pictures,
                             const std::string& preferred, const std::map<std::uint32_t, LensFreedom>& freedom,
                             const PhotosOptions& options, const Context& context);

}  // namespace malus
