#include <algorithm>
#include <cmath>
#include <sstream>

#include "malus/core/degrees_internal.h"
#include "malus/core/error.h"
#include "malus/core/median_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/stereo/intensity_pyramid_internal.h"
#include "malus/stereo/view_choice_internal.h"

namespace malus {
namespace {

/// Number of sample pixels per side of the image at which photos are judged.
constexpr int samples_a_side = 24;
/// A photo's quality grows with its angle to the station's view up to this angle, and falls beyond twice this angle.
constexpr double best_angle_rad = to_radians(20);
/// Photos that see the surface from directions less than this apart were taken from one place, by hand or tripod.
constexpr double one_place_rad = to_radians(2);
/// If the sweep's polynomial fits a lens with a larger error, this is logged.
constexpr double largest_fit_error_px = 0.05;
/// Photos with a shorter side below this are not halved.
constexpr int least_halved_px = 16;

/// Pixels of the level at which photos are judged. On a small or thin object, which has fewer samples than a side of
/// the image, they lie closer together.
std::vector<Eigen::Vector2i> sample_pixels(const Mask& mask, const Image<float>& log_depth) {
  std::vector<Eigen::Vector2i> samples;
  for (int step = std::max(1, std::min(mask.width(), mask.height()) / samples_a_side);; step /= 2) {
    samples.clear();
    for (int v = 0; v < mask.height(); v += step) {
      for (int u = 0; u < mask.width(); u += step) {
        if (mask(u, v) != 0 && std::isfinite(log_depth(u, v))) samples.emplace_back(u, v);
      }
    }
    if (step == 1 || samples.size() >= static_cast<std::size_t>(samples_a_side)) return samples;
  }
}

}  // namespace

ViewChoice::ViewChoice(const SweepInput& input, std::span<SweepView> views, const SweepOptions& options,
                       const Context& context)
    : station_(input.camera), options_(options) {
  // Often all photos are of one lens: one warning for all.
  std::size_t first = 0, count = 0;
  double worst_px = 0;
  for (SweepView& view : views) {
    photos_.emplace_back(view, ViewProjection(input.camera, input.pose, view.camera, view.pose));
    const double error_px = photos_.back().projection.fit_error_px();
    if (!(error_px > largest_fit_error_px)) continue;
    if (count++ == 0) first = photos_.size() - 1;
    worst_px = std::max(worst_px, error_px);
  }
  if (count == 0) return;
  std::ostringstream message;
  message << "surface sweep: views[" << first << "]";
  if (count > 1) message << " and " << count - 1 << " more";
  message << ": the lens is approximated to " << worst_px << " px only";
  context.log(LogLevel::warning, message.str());
}

void ViewChoice::measure(const MatchLevel& level, const Image<float>& log_depth) {
  const std::vector<Eigen::Vector2i> samples = sample_pixels(level.mask, log_depth);
  for (Photo& photo : photos_) {
    std::vector<double> parallax, resolution, angle;
    Eigen::Vector3d directions = Eigen::Vector3d::Zero();
    const Size size = photo.size;
    for (const Eigen::Vector2i& sample : samples) {
      constexpr double delta = 1e-3;
      const double z = std::exp(log_depth(sample.x(), sample.y()));
      const double x = sample.x() * level.reduction, y = sample.y() * level.reduction;
      const Eigen::Vector2d pixel = photo.projection.project(x, y, z);
      if (!(pixel.array() >= 0).all() || pixel.x() > size.width - 1 || pixel.y() > size.height - 1) continue;
      const Eigen::Vector2d farther = photo.projection.project(x, y, z * (1 + delta));
      const Eigen::Vector3d point = z * station_.ray(x, y);
      const double scale = photo.projection.focal() / photo.projection.depth_in_view(x, y, z) / (station_.focal() / z);
      resolution.push_back(scale);
      parallax.push_back((farther - pixel).norm() / delta / scale);
      const Eigen::Vector3d away = (photo.projection.center_in_station() - point).normalized();
      angle.push_back(std::acos(std::clamp(-away.dot(point.normalized()), -1.0, 1.0)));
      directions += away;
    }
    photo.parallax = median(parallax);
    photo.resolution = resolution.empty() ? 1 : median(resolution);
    const double total = std::max(1.0, static_cast<double>(samples.size()));
    const double a = median(angle), share = static_cast<double>(angle.size()) / total;
    photo.sees = !angle.empty() && a <= to_radians(options_.max_angle_deg);
    const bool usable = photo.sees && photo.parallax > 0;
    photo.quality = usable ? share * std::min(1.0, a / best_angle_rad) * std::min(1.0, 2 * best_angle_rad / a) : 0;
    photo.direction = directions.normalized();
    const Eigen::Vector3d& center = photo.projection.center_in_station();
    photo.azimuth_rad = std::atan2(center.y(), center.x());
  }
}

void ViewChoice::split() {
  std::vector<Photo*> used;
  std::vector<double> parallax;
  for (Photo& photo : photos_) {
    if (photo.quality <= 0) continue;
    used.push_back(&photo);
    parallax.push_back(photo.parallax);
  }
  if (used.empty()) {
    std::ostringstream message;
    message << "surface sweep: none of " << photos_.size()
            << " photos sees the object of the station's view from another direction within " << options_.max_angle_deg
            << " deg: check the poses, or photograph the object from around the station";
    throw data_error(message.str());
  }
  const double least = options_.min_parallax * median(parallax);
  const auto enough = static_cast<std::size_t>(2 * options_.best_views);
  std::sort(used.begin(), used.end(), [](const Photo* a, const Photo* b) { return a->parallax > b->parallax; });
  while (used.size() > 1 && used.back()->parallax < least &&
         (used.size() > enough || used.back()->parallax < 0.25 * least)) {
    used.back()->quality = 0;
    used.pop_back();
  }
  std::sort(used.begin(), used.end(), [](const Photo* a, const Photo* b) { return a->azimuth_rad < b->azimuth_rad; });
  // Photos from one place see the same mirror images and make the same mistakes: if one of them were in either half,
  // the halves would agree on these. So they stay together.
  places_ = 0;
  for (auto photo = used.begin(); photo != used.end(); ++photo) {
    const auto same = std::find_if(used.begin(), photo, [&](const Photo* other) {
      return other->direction.dot((*photo)->direction) > std::cos(one_place_rad);
    });
    (*photo)->subset = same != photo ? (*same)->subset : places_++ % 2;
  }
}

void ViewChoice::choose(const MatchLevel& level, const Image<float>& log_depth) {
  measure(level, log_depth);
  split();
}

std::vector<std::size_t> ViewChoice::seeing() const {
  std::vector<std::size_t> numbers;
  for (std::size_t k = 0; k < photos_.size(); ++k) {
    if (photos_[k].sees) numbers.push_back(k);
  }
  return numbers;
}

double ViewChoice::parallax(const MatchLevel& level) const {
  std::vector<double> parallax;
  for (const Photo& photo : photos_) {
    if (photo.quality > 0) parallax.push_back(photo.parallax / level.reduction);
  }
  return median(parallax);
}

void ViewChoice::Photo::take_level(int wanted, const Context& context) {
  int least_side = std::min(size.width, size.height), deepest = 0;
  for (; deepest < wanted && least_side >= least_halved_px; ++deepest) least_side = (least_side + 1) / 2;
  if (cells && depth == deepest) return;
  Image<float> reduced = intensity->empty() ? cells->intensity() : Image<float>();
  cells.reset();
  for (int level = 0; level < deepest; ++level) reduced = halved(reduced.empty() ? *intensity : reduced, context);
  cells.emplace(reduced.empty() ? *intensity : reduced, context);
  depth = deepest;
}

void ViewChoice::prepare(MatchLevel& level, const Context& context) {
  std::vector<Photo*> used;
  for (Photo& photo : photos_) {
    if (photo.quality > 0) used.push_back(&photo);
  }
  level.views.assign(used.size(), {});
  parallel_for(context, used.size(), 1, [&](std::size_t k, std::size_t) {
    Photo& photo = *used[k];
    // The level whose pixels are 0.7 to 1.4 times as large as those of the station's level.
    const double ratio = photo.resolution * level.reduction;
    photo.take_level(std::max(0, static_cast<int>(std::lround(std::log2(std::max(ratio, 1e-3))))), context);
    if (level.reduction == 1 && photo.depth == 0) *photo.intensity = {};
    level.views[k] = {&*photo.cells, 1.0F / static_cast<float>(1 << photo.depth), &photo.projection, photo.subset,
                      photo.quality};
  });
}

Image<float> ViewChoice::halved_photo(std::size_t at, const Context& context) const {
  const Photo& photo = photos_[at];
  return photo.intensity->empty() ? halved(photo.cells->intensity(), context) : halved(*photo.intensity, context);
}

}  // namespace malus
