#pragma once

#include <span>
#include <utility>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/stereo/surface_sweep_internal.h"
#include "malus/stereo/tile_matcher_internal.h"

namespace malus {

/// The photos as pyramids, and which of them a level is compared with.
class ViewChoice {
 public:
  ViewChoice(const SweepInput& input, std::span<const SweepView> views, const SweepOptions& options,
             const Context& context);

  int total() const { return static_cast<int>(photos_.size()); }
  /// Sets level.views to the photos that see the surface well: under an angle that is neither too flat nor nearly the
  /// station's own; each at the level of its pyramid that matches the station's resolution. Returns the parallax of
  /// their median, px of the level a unit of ln z. On the first call (`choose`) the photos are chosen and split into
  /// two halves that see the surface from the same sides; later calls keep the choice. Throws a data error if no photo
  /// sees the surface.
  double prepare(MatchLevel& level, const Image<float>& log_depth, bool choose, const Context& context);

 private:
  struct Photo {
    Photo(const SweepView& view, ViewProjection p) : intensity(&view.intensity), projection(std::move(p)) {}

    /// The level of this depth, or the last that is worth halving.
    std::size_t extend_pyramid(int depth, const Context& context);

    const Image<float>* intensity;
    ViewProjection projection;
    std::vector<PhotoCells> pyramid;
    Image<float> coarsest;   ///< the pyramid's last level in full precision, to be halved; empty if that is `intensity`
    double parallax = 0;     ///< px of the station's image a unit of ln z, median
    double resolution = 1;   ///< px of the photo a px of the station
    double quality = 0;      ///< 0 = not used
    double azimuth_rad = 0;  ///< of the camera's center about the station's axis
    int subset = 0;
  };

  void measure(const MatchLevel& level, const Image<float>& log_depth);
  void choose();

  Pinhole station_;
  SweepOptions options_;
  std::vector<Photo> photos_;
};

}  // namespace malus
