#include "malus/object/combine.h"

#include <cmath>
#include <functional>
#include <string>
#include <utility>

#include "malus/core/median_internal.h"
#include "malus/core/square_internal.h"
#include "malus/object/oriented_points_internal.h"
#include "malus/object/point_choice_internal.h"
#include "malus/object/station_means_internal.h"

namespace malus {
namespace {

std::vector<double> gsds_of(std::span<const ObjectView> views) {
  std::vector<double> gsds;
  for (const ObjectView& view : views) gsds.push_back(view.gsd);
  return gsds;
}

/// What CombinedViews::points is. `keep` gets the agreement of each view.
OrientedPoints combined_points(std::span<const ObjectView> views, const OrientedPoints& cloud, const Context& context,
                               const std::function<void(Agreement)>& keep) {
  context.validate();
  for (const ObjectView& view : views) view.validate();
  cloud.validate();
  std::vector<double> gsds = gsds_of(views);
  const std::vector<double> scales = scales_of(gsds);
  std::vector<OrientedPoints> parts, doubted;
  for (std::size_t k = 0; k < views.size(); ++k) {
    context.progress("object", static_cast<double>(k) / static_cast<double>(views.size()), views[k].name);
    StationMeans means = station_means(views, k, scales[k], context);
    parts.push_back(std::move(means.believed));
    doubted.push_back(std::move(means.doubtful));
    keep(std::move(means.agreement));
  }
  if (cloud.size() > 0 && !views.empty()) {
    const OrientedPoints flat = joined(std::move(doubted));
    parts.push_back(selected(flat, found_by(cloud, flat, percentile_in_place(gsds, 0.5), context)));
  }
  return joined(std::move(parts));
}

}  // namespace

void OrientedPoints::validate() const {
  const auto require = [&](std::size_t count, const char* values) {
    if (count == size()) return;
    throw input_error("oriented points: there are " + std::to_string(size()) + " points, but " + std::to_string(count) +
                      " values of " + values);
  };
  require(normals.size(), "normals");
  require(sigma.size(), "sigma");
  require(stations.size(), "stations");
  if (!scale.empty()) require(scale.size(), "scale");
}

AgreementFigures agreement_figures(std::span<const Agreement> agreements, double gsd) {
  double ratios2 = 0, distances2 = 0;
  std::size_t within = 0, contradictions = 0;
  std::vector<double> distances;
  for (const Agreement& agreement : agreements) {
    contradictions += agreement.contradictions;
    for (std::size_t i = 0; i < agreement.distances.size(); ++i) {
      const double ratio = agreement.distances[i] / agreement.expected[i];
      ratios2 += square(ratio);
      within += std::abs(ratio) < 2;
      distances2 += square(agreement.distances[i]);
      distances.push_back(std::abs(agreement.distances[i]));
    }
  }
  const auto count = static_cast<double>(distances.size()), contradicted = static_cast<double>(contradictions);
  AgreementFigures figures;
  if (count + contradicted > 0) figures.contradicted_fraction = contradicted / (count + contradicted);
  if (distances.empty()) return figures;
  figures.rms_ratio = std::sqrt(ratios2 / count);
  figures.within_two_sigma = static_cast<double>(within) / count;
  figures.rms_gsd = std::sqrt(distances2 / count) / gsd;
  figures.median_gsd = percentile_in_place(distances, 0.5) / gsd;
  return figures;
}

CombinedViews combine(std::span<const ObjectView> views, const OrientedPoints& cloud, const Context& context) {
  CombinedViews combined;
  combined.points = combined_points(views, cloud, context,
                                    [&](Agreement agreement) { combined.agreements.push_back(std::move(agreement)); });
  return combined;
}

OrientedPoints object_points(std::span<const ObjectView> views, std::span<const OrientedPoints> clouds,
                             const Context& context) {
  if (views.empty()) throw input_error("points of an object: there is no view");
  for (const OrientedPoints& cloud : clouds) cloud.validate();
  std::vector<double> gsds = gsds_of(views);
  const double gsd = percentile_in_place(gsds, 0.5);
  // Agreements are not kept: each holds a raster of a view, and nothing here needs them.
  OrientedPoints seen =
      combined_points(views, joined({clouds.begin(), clouds.end()}), context, [](const Agreement&) {});
  seen = without_coarser(std::move(seen), gsd, context);
  std::vector<OrientedPoints> parts(1);
  for (const OrientedPoints& cloud : clouds) parts.push_back(unseen_stereo(cloud, views, seen, context));
  parts[0] = std::move(seen);
  return without_outliers(joined(std::move(parts)), gsd, context);
}

}  // namespace malus
