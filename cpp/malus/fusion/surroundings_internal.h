#pragma once

#include <Eigen/Core>
#include <complex>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/polarization/ray_frame.h"

namespace malus {

/// Roughness (alpha of the facets' slopes) of most pixels, and of pixels with another finish, such as bare clay beside
/// glaze; 0 = none.
struct Finishes {
  double usual = 0.1, other = 0;
  bool operator==(const Finishes&) const = default;
};

/// Light that the surface mirrors: radiance of the surroundings by direction, reflected by microfacets.
///
/// The directions are those of the half vectors of light and optical axis, on square cells of the unit disc: equal
/// areas of the disc are equal solid angles of light, dω = 4 dh_x dh_y, and the disc covers all light that a surface
/// facing the camera can mirror. Facets follow the Beckmann distribution (Cook and Torrance 1982); their light is
/// polarized by Fresnel's equations about the half vector.
struct Surroundings {
  static constexpr int cells = 20;  ///< along the disc's diameter
  Finishes finishes;                ///< of the surface that mirrors it
  Image<float> radiance;            ///< cells × cells, not negative, in units of s0; 0 outside the disc

  /// Half vectors of the cells inside the disc (x to the right, y upwards), and their position in `radiance`.
  struct Cell {
    double hx = 0, hy = 0;
    int column = 0, row = 0;
  };
  static std::vector<Cell> all_cells();
};

/// Mirrored Stokes components of a pixel, with derivatives by its slopes.
struct MirroredLight {
  Eigen::Vector3d stokes = Eigen::Vector3d::Zero();  ///< s0, s1, s2 in the frame of the pixel's ray
  Eigen::Vector3d by_p = Eigen::Vector3d::Zero(), by_q = Eigen::Vector3d::Zero();
};

/// The light of some cells, prepared to be mirrored by many pixels.
class CellLights {
 public:
  explicit CellLights(const std::vector<Surroundings::Cell>& cells);

  Eigen::Index size() const { return x_.size(); }
  /// (s0, s1, s2) that a surface with slopes (p, q) mirrors from each cell of radiance 1. A metal's refractive index
  /// has an imaginary part > 0.
  void mirrored(double p, double q, const RayFrame& frame, double roughness, std::complex<double> index,
                Eigen::Ref<Eigen::Matrix3Xf> out) const;

 private:
  using Values = Eigen::Array<float, Eigen::Dynamic, 1, 0, Surroundings::cells * Surroundings::cells, 1>;
  Values x_, y_, z_;  ///< directions to the light, camera frame
  Values widening_;   ///< added to the square of the roughness, for the extent of the cells
};

/// The mirrored light as a function of the slopes, tabulated for some rays of a camera and interpolated: bicubic over
/// the slopes (stereographic, so that all zeniths are on a disc), bilinear over the rays.
class MirroredLightTable {
 public:
  MirroredLightTable(const Surroundings& surroundings, std::complex<double> index, const Pinhole& camera,
                     const Context& context);

  MirroredLight at(double p, double q, const RayFrame& frame) const;

 private:
  static constexpr int rays_u = 3, rays_v = 2;
  struct Value {
    float stokes[3];
  };
  MirroredLight of_ray(const Image<Value>& table, double a, double b) const;

  double first_x_ = 0, step_x_ = 1, first_y_ = 0, step_y_ = 1;  ///< of the rays' directions (x / z, y / z)
  std::vector<Image<Value>> tables_;                            ///< rays_u × rays_v, row by row
};

}  // namespace malus
