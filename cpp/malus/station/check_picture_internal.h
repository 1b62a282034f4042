#pragma once

#include <Eigen/Core>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/station/station.h"

namespace malus {

/// Data of a picture that shows whether prior and mask lie where the image shows the object.
struct CheckPicture {
  Image<float> image;  ///< the first polarized image as taken, mean of its channels [DN]
  Mask object;         ///< the mask; without one, all pixels
  /// The prior's points in the image: u, v [px] and z in the camera [unit of the station]; at most about 100,000,
  /// evenly sampled. Empty for a prior that is still to be made from photos.
  std::vector<Eigen::Vector3f> points;
};

/// Reads that data. Throws what the run would throw for files that cannot be read.
CheckPicture check_picture(const Station& station, const Context& context);

}  // namespace malus
