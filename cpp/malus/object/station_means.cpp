#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "malus/core/parallel_internal.h"
#include "malus/core/square_internal.h"
#include "malus/object/coarser_views_internal.h"
#include "malus/object/oriented_points_internal.h"
#include "malus/object/place_comparison_internal.h"
#include "malus/object/station_means_internal.h"
#include "malus/object/view_lookup_internal.h"

namespace malus {
namespace {

/// A place that only one station sees may be a rim: it must face the station, or stereo must support it.
constexpr double least_cosine_alone = 0.5;
/// A station's point is dropped if another station has a weight there that is larger by more than this factor.
constexpr double surer = 1.5;

/// Distance of another view's surface from a place, and its standard deviation.
struct Distance {
  double apart, expected;

  double ratio() const { return std::abs(apart) / expected; }
  bool contradicts() const { return !(ratio() < contradicting_ratio); }
};

/// The mean of a place over the view that it belongs to and others that are added.
class PlaceMean {
 public:
  PlaceMean(const ObjectView& view, const Place& place)
      : view_(view), place_(place), own_(place.cosine / square(view.usual_sigma)) {
    total_ = best_ = own_;
    cosines_ = place.cosine;
    stated_ = place.cosine / square(place.sigma);
    normal_ = own_ * place.normal;
  }

  /// The distance of the other's surface if it counts for the agreement, or contradicts the place.
  std::optional<Distance> add(const OtherView& other) {
    const auto there = compared(place_, other);
    if (!there) return {};
    const Meeting& at = there->at;
    // Another station may only exclude a point that it sees at a better angle.
    if (!there->near && at.weight > place_.cosine && in_front(*other.view, at, most_ratio)) excluded_ = true;
    if (there->near) {
      ++stations_;
      if (!is_finer(view_, place_.cosine, *other.view, at.weight)) average(*there, there->weight(other));
    }
    const Distance distance{there->apart, there->spread(place_)};
    if (distance.contradicts()) {
      if (!contradict_each_other(view_, place_, other, *there)) return {};
      farthest_ = std::max(farthest_, distance.ratio());
    } else {
      if (!there->same) return {};
      squares_ += square(distance.ratio());
      ++compared_;
    }
    return distance;
  }

  /// Moves and turns the place with the surface about it, as far as views with larger pixels ask for it.
  void add(const CoarserViews& coarser) {
    const double weight = coarser.weight[place_.pixel];
    total_ += weight;
    moved_ += coarser.move[place_.pixel];
    const Eigen::Map<const Eigen::Vector3f> turn(&coarser.turn[3 * place_.pixel]);
    normal_ += weight * place_.normal + turn.cast<double>();
  }

  float ratio() const {
    if (farthest_ > 0) return static_cast<float>(farthest_);
    return compared_ > 0 ? static_cast<float>(std::sqrt(squares_ / compared_))
                         : std::numeric_limits<float>::quiet_NaN();
  }
  /// Whether no other view sees through the point or sees it better.
  bool is_kept() const { return !excluded_ && surer * own_ >= best_; }
  bool is_believed() const { return stations_ > 1 || place_.cosine > least_cosine_alone; }

  void append_to(OrientedPoints& points) const {
    points.points.push_back(place_.point + moved_ / total_ * place_.normal);
    points.normals.push_back(normal_.normalized().cast<float>());
    points.sigma.push_back(static_cast<float>(std::sqrt(cosines_ / stated_)));
    points.stations.push_back(stations_);
  }

 private:
  void average(const PlaceComparison& there, double weight) {
    const Meeting& at = there.at;
    total_ += weight;
    moved_ += weight * there.apart;
    cosines_ += at.weight;
    stated_ += at.weight / square(at.sigma);
    normal_ += weight * at.normal;
    best_ = std::max(best_, weight);
  }

  const ObjectView& view_;
  const Place& place_;
  double own_, total_, best_, moved_ = 0;  // weights: this view's, of all, largest; sum of weighted moves
  double cosines_, stated_;                // sums of the viewing angles' cosines, and of these over stated variances
  Eigen::Vector3d normal_;
  std::uint16_t stations_ = 1;
  bool excluded_ = false;
  double squares_ = 0, farthest_ = 0;  // of distances over their standard deviations: sum of squares, contradiction
  int compared_ = 0;
};

/// Single distances are kept only at every n-th pixel, because each pixel may have one distance for every other view.
std::size_t distance_step(const ObjectView& view, std::size_t others) {
  std::size_t usable = 0;
  for (std::size_t i = 0; i < view.camera.size.area(); ++i) usable += view.usable[i] != 0;
  return std::max<std::size_t>(1, usable * others / most_compared);
}

/// The content of StationMeans for a block of pixels.
struct MeansOfBlock {
  OrientedPoints believed, doubtful;
  std::vector<Distance> distances;
  std::size_t contradictions = 0;

  void add(const ObjectView& view, const Place& place, const std::vector<OtherView>& others,
           const CoarserViews& coarser, bool with_distances, float& ratio) {
    PlaceMean mean(view, place);
    for (const OtherView& other : others) {
      const auto distance = mean.add(other);
      if (!distance || !with_distances) continue;
      if (distance->contradicts()) {
        ++contradictions;
      } else {
        distances.push_back(*distance);
      }
    }
    if (!coarser.empty()) mean.add(coarser);
    ratio = mean.ratio();
    if (mean.is_kept()) mean.append_to(mean.is_believed() ? believed : doubtful);
  }
};

OrientedPoints joined_with_scale(std::vector<OrientedPoints> parts, double scale) {
  OrientedPoints points = joined(std::move(parts));
  if (scale != 1) points.scale.assign(points.size(), static_cast<float>(scale));
  return points;
}

}  // namespace

StationMeans station_means(std::span<const ObjectView> views, std::size_t which, double scale, const Context& context) {
  const ObjectView& view = views[which];
  const std::vector<OtherView> others = others_of(views, which);
  const CoarserViews coarser = coarser_views(view, others, context);
  const std::size_t pixels = view.camera.size.area(), every = distance_step(view, others.size());
  StationMeans means;
  means.agreement.view = view.name;
  means.agreement.ratio = Image<float>(view.camera.size, 1, no_value);
  std::vector<MeansOfBlock> blocks((pixels + points_in_a_block - 1) / points_in_a_block);
  parallel_for(context, pixels, points_in_a_block, [&](std::size_t begin, std::size_t end) {
    const std::vector<Place> places = places_of(view, begin, end);
    Eigen::AlignedBox3d box;
    for (const Place& place : places) box.extend(place.point);
    std::vector<OtherView> near = others;
    std::erase_if(near, [&](const OtherView& other) { return !may_see(*other.view, box); });
    MeansOfBlock& block = blocks[begin / points_in_a_block];
    for (const Place& place : places) {
      block.add(view, place, near, coarser, place.pixel % every == 0, means.agreement.ratio[place.pixel]);
    }
  });
  std::vector<OrientedPoints> believed, doubtful;
  for (MeansOfBlock& block : blocks) {
    believed.push_back(std::move(block.believed));
    doubtful.push_back(std::move(block.doubtful));
    means.agreement.contradictions += block.contradictions;
    for (const auto& [apart, expected] : block.distances) {
      means.agreement.distances.push_back(apart);
      means.agreement.expected.push_back(expected);
    }
  }
  means.believed = joined_with_scale(std::move(believed), scale);
  means.doubtful = joined_with_scale(std::move(doubtful), scale);
  return means;
}

}  // namespace malus
