#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/stereo/surface_sweep_internal.h"
#include "malus/stereo/tile_matcher_internal.h"

namespace malus {

/// Chooses the photos that a level is compared with, and provides them at the level's resolution. Only one pyramid
/// level of each photo is kept at a time: photos take most of the memory, and halving them again takes little time
/// compared with the matching.
class ViewChoice {
 public:
  /// Refers to the intensities in `views`, which must outlive this object.
  ViewChoice(const SweepInput& input, std::span<SweepView> views, const SweepOptions& options, const Context& context);

  int total() const { return static_cast<int>(photos_.size()); }
  /// Chooses the photos that see the surface well, under an angle that is neither too flat nor nearly the station's
  /// own, and splits them into two halves of similar viewing directions; photos from one place are in the same half.
  /// Throws a data error if no photo sees the surface well.
  void choose(const MatchLevel& level, const Image<float>& log_depth);
  /// Numbers of the photos that see the surface within the largest angle, whether they were chosen or not.
  std::vector<std::size_t> seeing() const;
  /// Number of places that the chosen photos were taken from.
  int places() const { return places_; }
  /// Median parallax of the chosen photos, px of the level per unit of ln z.
  double parallax(const MatchLevel& level) const;
  /// Sets level.views to the photos chosen, each at the level of its pyramid that matches the station's resolution;
  /// views of an earlier level become invalid. Call the full-resolution level (reduction 1) last: it frees the
  /// intensities of the photos that it uses at full size.
  void prepare(MatchLevel& level, const Context& context);
  const ViewProjection& projection(std::size_t photo) const { return photos_[photo].projection; }
  /// A photo at half its size; several threads may call this at once.
  Image<float> halved_photo(std::size_t photo, const Context& context) const;

 private:
  struct Photo {
    Photo(SweepView& view, ViewProjection p)
        : intensity(&view.intensity), size(view.camera.size), projection(std::move(p)) {}

    /// Makes the cells of the pyramid level `depth`, or of the last level that the photo's size allows.
    void take_level(int depth, const Context& context);

    Image<float>* intensity;  ///< of the view; empty once the cells hold the full photo and replace it
    Size size;
    ViewProjection projection;
    std::optional<PhotoCells> cells;
    int depth = 0;           ///< pyramid level of the cells
    double parallax = 0;     ///< px of the station's image per unit of ln z, median
    double resolution = 1;   ///< px of the photo per px of the station
    double quality = 0;      ///< 0 = not used
    bool sees = false;       ///< the surface, within the largest angle
    double azimuth_rad = 0;  ///< direction of the camera's center around the station's axis
    int subset = 0;
    /// Mean direction from the surface to the camera.
    Eigen::Vector3d direction = Eigen::Vector3d::Zero();
  };

  void measure(const MatchLevel& level, const Image<float>& log_depth);
  void split();

  Pinhole station_;
  SweepOptions options_;
  std::vector<Photo> photos_;
  int places_ = 0;
};

}  // namespace malus
