#pragma once

#include <Eigen/Core>
#include <vector>

#include "malus/core/cell_values_internal.h"
#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// Which share of the movement from the prior to the refined surface is gain, for each scale and region.
///
/// Noise and misaligned images look like detail. A surface takes up half of these errors, because one depth explains
/// two Stokes components of each pixel. The other half stays in the residual, which therefore shows how much the
/// surface took up. With d the change of the predicted (s1, s2) from the prior to the result and r the residual at the
/// result, summed over the cells of a region,
///   h = d·d / (d·d + d·r): the share of the movement along d supported by the data that the surface has made;
///   e² = (r·r − (d·r)² / d·d) / (d·d / h²): squared residual across d, relative to the square of the whole movement
///   supported by the data; r·r across d counts as at least the images' noise, which a surface can follow exactly;
///   gain = (1 − c e²) / h, from 0 to 1, as in Wiener's filter.
/// The products are those of degrees of polarization: each cell's are divided by its squared s0.
/// Scales are dyadic: pixels minus their mean over 4 × 4 px, these means minus those over 8 × 8 px, … and the means
/// over the largest cells. c is half: errors act on both slopes, and half of their squared sum has a curl, which no
/// surface can take up, so that it stays in the residual. c is a quarter at the finest scale, where a surface given at
/// the pixels' corners cannot follow every pattern of the pixels.
/// A metal's s0 is a third value, scaled by its error to the unit of (s1, s2). Texture in s0 looks like slopes, and the
/// surface takes it up pixel by pixel: so c is half at the finest scale, too.
class GainByScale {
 public:
  /// noise_share: as RefinementImage's.
  GainByScale(Size image, bool of_metal, double noise_share = 1);

  /// Adds some rows of a part. The part has the refined surface and the weights at it.
  void add(const RefinementField& part, RowRange rows, int first_row, const Context& context);

  /// Gains of each scale, from the finest to the means of the largest cells, and of all scales together (each scale
  /// weighted by how much it changes the polarization).
  struct Gains {
    struct Scale {
      int cell_px = 1;  ///< of the raster of gains
      Image<float> gain;
    };
    std::vector<Scale> scales;
    Scale all;
  };
  Gains gains(const Context& context) const;

 private:
  /// s1, s2, and of a metal s0, scaled to the error of s1 and s2.
  using Stokes = Eigen::Vector3d;
  /// Weighted sums over the pixels of a cell.
  struct Cell {
    double weight = 0;
    double noise = 0;                                       ///< of the sums: variance of s1 and s2 together
    Stokes change = Stokes::Zero(), rest = Stokes::Zero();  ///< sums of d and r
    Cell& operator+=(const Cell& other) {
      weight += other.weight;
      noise += other.noise;
      change += other.change;
      rest += other.rest;
      return *this;
    }
  };
  /// Sums over a region.
  struct Products {
    Image<float> dd, dr, rr;
    Image<float> nn;  ///< expected of rr, if it is the camera's noise alone
    explicit Products(Size cells) : dd(cells), dr(cells), rr(cells), nn(cells) {}
    void add(std::size_t cell, double weight, const Stokes& change, const Stokes& rest, double noise);
  };
  static Gains::Scale gain_of(const Products& products, int cell_px, double of_rest, const Context& context);
  static Image<Cell> parents_of(const Image<Cell>& cells);

  static constexpr int finest_px = 4, coarsest_px = 64;

  bool of_metal_;
  double noise_share_;
  Image<Cell> cells_;
  Products within_;  ///< of pixels against the means of their cells
};

/// The movement from the prior with each scale multiplied by its gain, at the nodes of the object.
Image<float> movement_that_is_gain(const RefinementImage& image, const Image<double>& x_prior,
                                   const GainByScale::Gains& gains, const Context& context);

}  // namespace malus
