#include <cmath>
#include <sstream>

#include "malus/core/digits_internal.h"
#include "malus/station/prior_scale_internal.h"

namespace malus {
namespace {

/// Error of a scale bar after scaling, in the station's unit; 0 for a single distance, which is met up to rounding.
double bar_error(const StationFile& station, std::size_t bar) {
  constexpr double rounding = 1e-9;  // relative to the distance
  const double error = station.scale_errors[bar];
  return std::abs(error) < rounding * station.scale_bars[bar].distance ? 0 : error;
}

}  // namespace

PointCloud scaled(PointCloud cloud, double scale) {
  for (Eigen::Vector3d& point : cloud.points) point *= scale;
  return cloud;
}

TriangleMesh scaled(TriangleMesh mesh, double scale) {
  mesh.vertices = scaled(std::move(mesh.vertices), scale);
  return mesh;
}

Shape scaled(Shape shape, double scale) {
  const auto scale_lengths = [scale](auto& some) {
    if constexpr (requires { some.point; }) some.point *= scale;
    if constexpr (requires { some.center; }) some.center *= scale;
    if constexpr (requires { some.radius; }) some.radius *= scale;
  };
  std::visit(scale_lengths, shape);
  return shape;
}

Image<float> scaled(Image<float> depth, double scale) {
  for (float& z : depth) z = static_cast<float>(scale * z);
  return depth;
}

PriorOptions with_stated_sigma(PriorOptions options, const StationFile& station) {
  if (!options.sigma) options.sigma = station.prior_sigma;
  return options;
}

std::string describe_scale(const StationFile& station) {
  if (station.scale_errors.empty()) return {};
  std::ostringstream text;
  text << "known distances make the prior " << with_digits(station.prior_scale, 6)
       << " times as large; they are then off by";
  for (std::size_t i = 0; i < station.scale_errors.size(); ++i) {
    text << (i == 0 ? " " : ", ") << with_digits(bar_error(station, i), 3)
         << (station.scale_bars[i].check ? " (check)" : "");
  }
  text << " " << station.unit;
  return text.str();
}

Json scale_json(const StationFile& station) {
  if (station.scale_errors.empty()) return nullptr;
  Json distances = Json::array();
  for (std::size_t i = 0; i < station.scale_errors.size(); ++i) {
    const ScaleBar& bar = station.scale_bars[i];
    const double residual = bar_error(station, i);
    distances.push_back({{"name", "[[scale]] " + std::to_string(i + 1)},
                         {"check", bar.check},
                         {"distance", bar.distance},
                         {"adjusted", bar.distance + residual},
                         {"residual", residual}});
  }
  return {{"scale", station.prior_scale}, {"distances", distances}};
}

std::vector<std::string> scale_warnings(const StationFile& station) {
  constexpr double worth_a_warning = 0.005;  // of the distance
  std::vector<std::string> warnings;
  for (std::size_t i = 0; i < station.scale_errors.size(); ++i) {
    const ScaleBar& bar = station.scale_bars[i];
    if (std::abs(station.scale_errors[i]) <= worth_a_warning * bar.distance) continue;
    warnings.push_back("[[scale]] " + std::to_string(i + 1) + (bar.check ? " (check)" : "") + ": " +
                       with_digits(bar.distance, 6) + " " + station.unit + " known, off by " +
                       with_digits(station.scale_errors[i], 3) + " " + station.unit);
  }
  return warnings;
}

}  // namespace malus
