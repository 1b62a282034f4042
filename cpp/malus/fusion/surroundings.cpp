#include <algorithm>
#include <cmath>
#include <numbers>

#include "malus/core/parallel_internal.h"
#include "malus/fusion/fresnel_factors_internal.h"
#include "malus/fusion/surroundings_internal.h"

namespace malus {
namespace {

constexpr double disc_radius = 0.985;  // beyond it the light comes from behind the surface's horizon
constexpr double cell_side = 2.0 / Surroundings::cells;
constexpr double solid_angle = 4 * cell_side * cell_side;

constexpr int table_side = 65;        // slopes along an axis of the stereographic disc
constexpr double table_edge = 0.985;  // 89° from the ray

/// Stereographic coordinate of table line i.
double table_coordinate(int i) {
  return table_edge * (2.0 * i / (table_side - 1) - 1);
}

/// Value and derivative weights of Catmull and Rom's spline through four values.
void catmull_rom(double t, double (&value)[4], double (&slope)[4]) {
  const double t2 = t * t, t3 = t2 * t;
  value[0] = 0.5 * (-t3 + 2 * t2 - t);
  value[1] = 0.5 * (3 * t3 - 5 * t2 + 2);
  value[2] = 0.5 * (-3 * t3 + 4 * t2 + t);
  value[3] = 0.5 * (t3 - t2);
  slope[0] = 0.5 * (-3 * t2 + 4 * t - 1);
  slope[1] = 0.5 * (9 * t2 - 10 * t);
  slope[2] = 0.5 * (-9 * t2 + 8 * t + 1);
  slope[3] = 0.5 * (3 * t2 - 2 * t);
}

}  // namespace

std::vector<Surroundings::Cell> Surroundings::all_cells() {
  std::vector<Cell> all;
  for_each_pixel(Size{cells, cells}, [&](int column, int row) {
    const double hx = (column + 0.5) * cell_side - 1, hy = (row + 0.5) * cell_side - 1;
    if (std::hypot(hx, hy) < disc_radius) all.push_back({hx, hy, column, row});
  });
  return all;
}

CellLights::CellLights(const std::vector<Surroundings::Cell>& cells) {
  // The extent of a cell widens the lobe. A Gaussian of slopes has variance alpha² / 2.
  constexpr double spread = 0.45;
  for (Values* values : {&x_, &y_, &z_, &widening_}) values->resize(static_cast<Eigen::Index>(cells.size()));
  for (std::size_t i = 0; i < cells.size(); ++i) {
    const auto& [hx, hy, column, row] = cells[i];
    const auto at = static_cast<Eigen::Index>(i);
    const double hz = std::sqrt(std::max(1 - hx * hx - hy * hy, 1e-6));
    // The optical axis, (0, 0, −1) towards the camera, mirrored about the half vector (hx, −hy, −hz).
    x_[at] = static_cast<float>(2 * hz * hx);
    y_[at] = static_cast<float>(-2 * hz * hy);
    z_[at] = static_cast<float>(1 - 2 * hz * hz);
    widening_[at] = static_cast<float>(2 * std::pow(spread * cell_side, 2) / std::sqrt(std::max(hz, 0.2)));
  }
}

// Single precision and whole arrays: the compiler handles several cells at a time.
void CellLights::mirrored(double p, double q, const RayFrame& frame, double roughness, std::complex<double> index,
                          Eigen::Ref<Eigen::Matrix3Xf> out) const {
  constexpr float smallest_cosine = 0.02F, farthest = 30, shortest2 = 1e-6F;  // exp(-30) is nothing
  const auto cos_normal = static_cast<float>(1 / std::sqrt(1 + p * p + q * q));
  const Eigen::Vector3f view = frame.view.cast<float>(), right = frame.right.cast<float>(), up = frame.up.cast<float>();
  const Eigen::Vector3f normal = (static_cast<float>(p) * right + static_cast<float>(q) * up + view) * cos_normal;
  const Values hx = x_ + view.x(), hy = y_ + view.y(), hz = z_ + view.z();
  const auto along = [&](const Eigen::Vector3f& axis) { return axis.x() * hx + axis.y() * hy + axis.z() * hz; };
  const Values length2 = hx.square() + hy.square() + hz.square();
  const Values length = length2.max(shortest2).sqrt();
  const Values cos_facet = along(normal) / length, cos_half = along(view) / length;
  const Values cos_light = normal.x() * x_ + normal.y() * y_ + normal.z() * z_;
  const Values cos2 = cos_facet.square(), alpha2 = widening_ + static_cast<float>(roughness * roughness);
  const Values exponent = (1 - cos2) / (cos2 * alpha2);
  const Values facets = (-exponent).exp() / (std::numbers::pi_v<float> * alpha2 * cos2.square());
  const Values masking = (2 * cos_facet * cos_light.min(cos_normal) / cos_half).min(1.0F);
  const Values hp = along(right) / (cos_half * length), hq = along(up) / (cos_half * length);
  const Values weight = (length2 > shortest2 && cos_facet >= smallest_cosine && cos_light > 0.0F &&
                         cos_half >= 0.5F * smallest_cosine && exponent <= farthest)
                            .select(static_cast<float>(solid_angle) / (4 * cos_normal) * facets * masking, 0.0F);
  Values reflectance(size()), specular(size());
  if (index.imag() == 0) {
    mirrored_by_dielectric(cos_half, static_cast<float>(index.real()), reflectance, specular);
  } else {
    for (Eigen::Index i = 0; i < size(); ++i) {
      if (!(weight[i] > 0)) continue;
      const MirrorFactors metal = mirror_factors(hp[i] * hp[i] + hq[i] * hq[i], index);
      reflectance[i] = static_cast<float>(metal.reflectance);
      specular[i] = static_cast<float>(metal.specular);
    }
  }
  // Where no light is mirrored, the other factors may be infinite.
  const auto visible = weight > 0.0F;
  out.row(0) = visible.select(weight * reflectance, 0.0F).matrix().transpose();
  out.row(1) = visible.select(-weight * specular * (hp.square() - hq.square()), 0.0F).matrix().transpose();
  out.row(2) = visible.select(-2 * weight * specular * hp * hq, 0.0F).matrix().transpose();
}

MirroredLightTable::MirroredLightTable(const Surroundings& surroundings, std::complex<double> index,
                                       const Pinhole& camera, const Context& context) {
  const std::vector<Surroundings::Cell> all = Surroundings::all_cells();
  std::vector<Surroundings::Cell> cells;
  std::vector<float> radiances;
  for (const Surroundings::Cell& cell : all) {
    const float radiance = surroundings.radiance(cell.column, cell.row);
    if (radiance <= 0) continue;
    cells.push_back(cell);
    radiances.push_back(radiance);
  }
  const CellLights lights(cells);
  const Eigen::Map<const Eigen::VectorXf> radiance(radiances.data(), static_cast<Eigen::Index>(radiances.size()));
  const auto ray_u = [&](int i) { return camera.size.width * (i + 0.5) / rays_u; };
  const auto ray_v = [&](int j) { return camera.size.height * (j + 0.5) / rays_v; };
  first_x_ = (ray_u(0) - camera.cx) / camera.fx;
  step_x_ = (ray_u(1) - ray_u(0)) / camera.fx;
  first_y_ = (ray_v(0) - camera.cy) / camera.fy;
  step_y_ = (ray_v(1) - ray_v(0)) / camera.fy;
  tables_.assign(rays_u * rays_v, Image<Value>({table_side, table_side}));
  parallel_rows(context, rays_u * rays_v * table_side, [&](int line) {
    const int ray = line / table_side, row = line % table_side;
    const RayFrame frame = ray_frame(&camera, ray_u(ray % rays_u), ray_v(ray / rays_u));
    Eigen::Matrix3Xf response(3, radiance.size());
    for (int column = 0; column < table_side; ++column) {
      const double a = table_coordinate(column), b = table_coordinate(row);
      // Outside the disc the values only keep the spline smooth inside.
      constexpr double horizon = 0.97;
      const double to_slope = 2 / (1 - std::min(a * a + b * b, horizon));
      lights.mirrored(to_slope * a, to_slope * b, frame, surroundings.finishes.usual, index, response);
      const Eigen::Vector3f sum = response * radiance;
      tables_[static_cast<std::size_t>(ray)](column, row) = {{sum[0], sum[1], sum[2]}};
    }
  });
}

MirroredLight MirroredLightTable::of_ray(const Image<Value>& table, double a, double b) const {
  constexpr double per_line = (table_side - 1) / (2 * table_edge);
  const auto place = [](double coordinate) {
    return std::clamp((coordinate + table_edge) * per_line, 1.0, static_cast<double>(table_side - 2) - 1e-9);
  };
  const double x = place(a), y = place(b);
  const int column = static_cast<int>(x), row = static_cast<int>(y);
  double value_x[4], slope_x[4], value_y[4], slope_y[4];
  catmull_rom(x - column, value_x, slope_x);
  catmull_rom(y - row, value_y, slope_y);
  MirroredLight light;
  for (int j = 0; j < 4; ++j) {
    const Value* line = table.row(row - 1 + j) + (column - 1);
    for (int k = 0; k < 3; ++k) {
      double value = 0, slope = 0;
      for (int i = 0; i < 4; ++i) {
        value += value_x[i] * line[i].stokes[k];
        slope += slope_x[i] * line[i].stokes[k];
      }
      light.stokes[k] += value_y[j] * value;
      light.by_p[k] += value_y[j] * slope * per_line;
      light.by_q[k] += slope_y[j] * value * per_line;
    }
  }
  return light;
}

MirroredLight MirroredLightTable::at(double p, double q, const RayFrame& frame) const {
  const double root = std::sqrt(1 + p * p + q * q), scale = 1 / (1 + root);
  const double a = p * scale, b = q * scale;
  const Eigen::Vector3d ray = -frame.view;
  const double x = std::clamp((ray.x() / ray.z() - first_x_) / step_x_, 0.0, rays_u - 1.0);
  const double y = std::clamp((ray.y() / ray.z() - first_y_) / step_y_, 0.0, rays_v - 1.0);
  const int column = std::min(static_cast<int>(x), rays_u - 2), row = std::min(static_cast<int>(y), rays_v - 2);
  MirroredLight light;
  for (int k = 0; k < 4; ++k) {
    const int i = column + k % 2, j = row + k / 2;
    const double weight = (1 - std::abs(x - i)) * (1 - std::abs(y - j));
    if (weight <= 0) continue;
    const MirroredLight part = of_ray(tables_[static_cast<std::size_t>(j * rays_u + i)], a, b);
    light.stokes += weight * part.stokes;
    light.by_p += weight * part.by_p;
    light.by_q += weight * part.by_q;
  }
  // From derivatives by the stereographic coordinates to those by the slopes.
  const double by_g = -scale * scale / root;
  const double a_by_p = scale + p * p * by_g, b_by_q = scale + q * q * by_g, cross = p * q * by_g;
  const Eigen::Vector3d by_a = light.by_p, by_b = light.by_q;
  light.by_p = by_a * a_by_p + by_b * cross;
  light.by_q = by_a * cross + by_b * b_by_q;
  return light;
}

}  // namespace malus
