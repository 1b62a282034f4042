#pragma once

#include <array>
#include <cstddef>
#include <functional>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/image.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/stereo/photo_cells_internal.h"
#include "malus/stereo/view_projection_internal.h"

namespace malus {

/// A photo at the pyramid level whose resolution matches the station's.
struct MatchView {
  const PhotoCells* photo = nullptr;
  float scale = 1;  ///< pixels of this level per pixel of the full photo
  const ViewProjection* projection = nullptr;
  int subset = 0;      ///< 0 or 1: which of the two disjoint halves it belongs to
  double quality = 1;  ///< preference among views that see a pixel
};

/// The station's view at one pyramid level and the photos to compare it with.
struct MatchLevel {
  Image<float> reference;
  Mask mask;
  Pinhole camera;
  int reduction = 1;  ///< side of the level's pixels, in pixels of the station's image
  std::vector<MatchView> views;
};

/// How photos are compared.
struct MatchSettings {
  int radius = 3;              ///< of the square window, px
  int best = 5;                ///< number of best views that are averaged
  int max_views = 12;          ///< largest number of views compared in one tile
  float noise_variance = 0;    ///< of an intensity; prevents windows without texture from matching by their noise
  bool compare_halves = true;  ///< score the two disjoint subsets too
};

/// Normalized cross-correlation of one tile of the station's view with the photos, for surfaces offset from a base
/// surface. The windows lie on the base surface and follow its slope.
class TileMatcher {
 public:
  /// Mean of the best views' correlations (negative ones count as 0), one value per pixel of the tile.
  struct Scores {
    std::vector<float> all;
    std::array<std::vector<float>, 2> half;  ///< of the two subsets
    std::vector<float> lines;                ///< scratch: sums along the rows of a window, for each view
  };

  /// ln z of the base surface at a pixel of the level, NaN outside the object.
  using Surface = std::function<float(int u, int v)>;

  TileMatcher(const MatchLevel& level, PixelRect tile, const Surface& log_depth, const MatchSettings& settings);

  /// Number of compared views, which see at least one pixel of the tile; without any, every score is 0.
  std::size_t views() const { return views_.size(); }
  /// Number of compared views that see each pixel.
  const std::vector<float>& seen() const { return count_; }
  /// Whether both halves see a pixel.
  bool halves_see(std::size_t pixel) const { return half_count_[0][pixel] > 0 && half_count_[1][pixel] > 0; }
  /// Prepares for offsets of ln z in [center − half_range, center + half_range], over which a pixel's path through a
  /// photo is approximated by a parabola.
  void prepare(float center, float half_range);
  /// May be called by several threads at once, each with its own `scores`.
  void score(float offset, Scores& scores) const;

 private:
  struct View {
    const MatchView* view;
    std::vector<float> seen;                 ///< 1 or 0, for each pixel of the tile
    std::array<std::vector<float>, 6> path;  ///< x0 x1 x2 y0 y1 y2, for each pixel of the padded tile
  };

  std::size_t tile_pixels() const { return tile_.size().area(); }
  void take_reference(const MatchLevel& level, const Surface& log_depth);
  void choose_views(const MatchLevel& level);
  void project(const View& view, float offset, std::vector<float>& x, std::vector<float>& y) const;

  PixelRect tile_, padded_;
  MatchSettings settings_;
  double reduction_;
  std::size_t stride_, rows_;             ///< of the padded tile
  std::vector<float> depth_;              ///< base surface, padded
  std::vector<float> weight_, weighted_;  ///< 1 on the object, 0 elsewhere; this weight times the reference; padded
  std::vector<float> inverse_count_, mean_, inverse_deviation_;  ///< of the reference's windows
  std::vector<View> views_;
  std::vector<float> count_;
  std::array<std::vector<float>, 2> half_count_;
  float center_ = 0, half_range_ = 1;
  float projected_ = 0;  ///< offset that the paths' first coefficients were projected for
};

}  // namespace malus
