#pragma once

#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/stereo/surface_sweep_internal.h"
#include "malus/stereo/tile_matcher_internal.h"

namespace malus {

/// Which photos a level is compared with, and these at its resolution. Of each photo there is one level of its pyramid
/// at a time: photos take most of the memory, and halving them again takes no time beside comparing them.
class ViewChoice {
 public:
  /// Their intensities are taken from `views`, which must outlive this.
  ViewChoice(const SweepInput& input, std::span<SweepView> views, const SweepOptions& options, const Context& context);

  int total() const { return static_cast<int>(photos_.size()); }
  /// Chooses the photos that see the surface well, under an angle that is neither too flat nor nearly the station's
  /// own, and splits them into two halves that see it from the same sides. Throws a data error if none does.
  void choose(const MatchLevel& level, const Image<float>& log_depth);
  /// Parallax of the median of the photos chosen, px of the level a unit of ln z.
  double parallax(const MatchLevel& level) const;
  /// Sets level.views to the photos chosen, each at the level of its pyramid that matches the station's resolution;
  /// those of a level before must not be used any more. The level of reduction 1 is the last: a photo that it needs in
  /// full is kept as cells only, and the intensity of its view is let go.
  void prepare(MatchLevel& level, const Context& context);
  /// A photo at half its size.
  Image<float> halved_photo(std::size_t photo, const Context& context) const;

 private:
  struct Photo {
    Photo(SweepView& view, ViewProjection p)
        : intensity(&view.intensity), size(view.camera.size), projection(std::move(p)) {}

    /// Makes the cells of the pyramid's level of this depth, or of the last that is worth halving.
    void take_level(int depth, const Context& context);

    Image<float>* intensity;  ///< of the view; empty once the cells are of the full photo and it is not needed
    Size size;
    ViewProjection projection;
    std::optional<PhotoCells> cells;
    int depth = 0;           ///< of the cells
    double parallax = 0;     ///< px of the station's image a unit of ln z, median
    double resolution = 1;   ///< px of the photo a px of the station
    double quality = 0;      ///< 0 = not used
    double azimuth_rad = 0;  ///< of the camera's center about the station's axis
    int subset = 0;
  };

  void measure(const MatchLevel& level, const Image<float>& log_depth);
  void split();

  Pinhole station_;
  SweepOptions options_;
  std::vector<Photo> photos_;
};

}  // namespace malus
