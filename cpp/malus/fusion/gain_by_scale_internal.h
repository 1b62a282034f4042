#pragma once

#include <array>
#include <vector>

#include "malus/core/cell_values_internal.h"
#include "malus/core/context.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {

/// What of the movement from the prior to the refined surface is gain: scale by scale and region by region.
///
/// Noise, and images that lie askew on each other, look like detail. A surface takes up half of them: two Stokes
/// components of each pixel are explained by one depth. What it cannot take up is left over, and tells how much it took
/// up. With d the change of the predicted (s1, s2) from the prior to the result and r what is left over there, summed
/// over the cells of a region,
///   h = d·d / (d·d + d·r): the share of what the data ask for along d that the surface has moved;
///   e² = (r·r − (d·r)² / d·d) / (d·d / h²): what is left over across d, beside all that they ask for;
///   gain = (1 − c e²) / h, from 0 to 1, as Wiener's filter has it.
/// Scales are dyadic: what a pixel has beyond the mean of 4 × 4 px, these beyond 8 × 8 px, … and the means of the
/// largest cells. c is half: the derivatives by both slopes are in what is left over, and half of the square of such
/// errors has a curl, which no surface can take up. It is a quarter at the finest scale, where a surface at the pixels'
/// corners cannot follow all that pixels have.
/// A metal's s0 is a third value, in units of its errors. Its texture looks like slopes, which the surface takes up
/// pixel by pixel: so c is half at the finest scale, too.
class GainByScale {
 public:
  GainByScale(Size image, bool of_metal);

  /// Adds some of a part's rows. The part is at the refined surface, and its weights are of it.
  void add(const RefinementField& part, RowRange rows, int first_row, const Context& context);

  /// Gains of each scale, from the finest to the means of the largest cells, and of all scales together (each counts by
  /// what it changes of the polarization).
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
  struct Stokes {
    double s1 = 0, s2 = 0;
    double s0 = 0;  ///< of a metal, in units of the errors of the others
    double dot(const Stokes& other) const { return s1 * other.s1 + s2 * other.s2 + s0 * other.s0; }
    Stokes& operator+=(const Stokes& other) {
      s1 += other.s1;
      s2 += other.s2;
      s0 += other.s0;
      return *this;
    }
    Stokes operator-(const Stokes& other) const { return {s1 - other.s1, s2 - other.s2, s0 - other.s0}; }
    Stokes operator*(double factor) const { return {factor * s1, factor * s2, factor * s0}; }
    Stokes operator/(double value) const { return {s1 / value, s2 / value, s0 / value}; }
  };
  /// Pixels of a cell, by their weights.
  struct Cell {
    double weight = 0;
    Stokes change, rest;  ///< sums of d and r
    Cell& operator+=(const Cell& other) {
      weight += other.weight;
      change += other.change;
      rest += other.rest;
      return *this;
    }
  };
  /// Sums over a region.
  struct Products {
    Image<float> dd, dr, rr;
    explicit Products(Size cells) : dd(cells), dr(cells), rr(cells) {}
    void add(std::size_t cell, double weight, const Stokes& change, const Stokes& rest);
  };
  static Gains::Scale gain_of(const Products& products, int cell_px, double of_rest, const Context& context);
  static Image<Cell> parents_of(const Image<Cell>& cells);

  static constexpr int finest_px = 4, coarsest_px = 64;

  bool of_metal_;
  Image<Cell> cells_;
  Products within_;  ///< of pixels against the means of their cells
};

/// The movement from the prior with each scale times its gain, at the nodes of the object.
Image<float> movement_that_is_gain(const RefinementImage& image, const Image<double>& x_prior,
                                   const GainByScale::Gains& gains, const Context& context);

}  // namespace malus
