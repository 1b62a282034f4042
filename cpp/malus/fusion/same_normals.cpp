#include <algorithm>
#include <cmath>
#include <vector>

#include "malus/core/even_choice_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/robust_spread_internal.h"
#include "malus/fusion/same_normals_internal.h"
#include "malus/fusion/surroundings_internal.h"

namespace malus {

double distance_of_same_normals(const RefinementImage& image) {
  struct Places {
    std::vector<double> u, v;
  };
  constexpr double per_unit = 0.5 * Surroundings::cells, most_pixels = 4e5;
  Image<Places> cells({Surroundings::cells, Surroundings::cells});
  for_each_chosen(image.usable, most_pixels, [&](int u, int v) {
    const Eigen::Vector3d normal = image.frame_at(u, v).normal(central_slopes(image, u, v));
    const auto cell = [](double component) {
      return std::clamp(static_cast<int>((component + 1) * per_unit), 0, Surroundings::cells - 1);
    };
    Places& places = cells(cell(normal.x()), cell(normal.y()));
    places.u.push_back(u);
    places.v.push_back(v);
  });
  double sum = 0, count = 0;
  for (const Places& places : cells) {
    if (places.u.empty()) continue;
    const auto pixels = static_cast<double>(places.u.size());
    sum += pixels *
           std::hypot(robust_spread_about(median(places.u), places.u), robust_spread_about(median(places.v), places.v));
    count += pixels;
  }
  constexpr double least_px = 1;  // if no two pixels share a normal, the spread is 0, which would mean no limit
  return std::max(sum / std::max(count, 1.0), least_px);
}

}  // namespace malus
