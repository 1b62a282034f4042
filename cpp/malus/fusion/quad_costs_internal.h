#pragma once

#include <ceres/cost_function.h>
#include <ceres/loss_function.h>

#include <array>
#include <memory>
#include <vector>

#include "malus/fusion/refinement_field_internal.h"

namespace malus {

// Ceres sees the unknowns in quads, parameter blocks of 2 × 2 pixels (order: (0,0), (1,0), (0,1), (1,1)). One cost
// function a quad instead of one a difference pair keeps Ceres' bookkeeping (cells, products, ordering) small beside
// the arithmetic. Every cost joins neighboring quads only, diagonal ones included (the prior's those of its block):
// the elimination order counts on it. Weights and log_body are read from the field, which must not change during a
// solve.

inline constexpr int quad_px = 2;

/// A quad by its position in units of quads.
struct QuadIndex {
  int column = 0, row = 0;
  bool operator==(const QuadIndex&) const = default;
};

/// Whether any pixel of the quad is on the object.
bool quad_has_object(const RefinementField& field, QuadIndex quad);

/// Cost function over the existing ones among some quads; `quads()` are its parameter blocks, in order.
class QuadCost : public ceres::CostFunction {
 public:
  const std::vector<QuadIndex>& quads() const { return quads_; }

  /// From now on evaluates to zeros while `*finished`.
  void watch(const bool* finished) { finished_ = finished; }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const final;

 protected:
  QuadCost(const RefinementField& field, std::vector<QuadIndex> quads, int residuals);

  /// Residuals and Jacobians start as zeros.
  virtual void evaluate(double const* const* parameters, double* residuals, double** jacobians) const = 0;

  const RefinementField& field_;
  std::vector<QuadIndex> quads_;

 private:
  const bool* finished_ = nullptr;
};

/// Stokes residuals of one pixel in standard deviations. 2 residuals, of a metal 3, with that of s0; quads: those that
/// hold its four nodes.
class StokesCost final : public QuadCost {
 public:
  StokesCost(const RefinementField& field, int u, int v);

 private:
  void evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

  int u_, v_;
};

/// Cauchy loss of a pixel's Stokes residuals times its regional weight.
class StokesLoss final : public ceres::LossFunction {
 public:
  StokesLoss(const RefinementField& field, int u, int v) : field_(field), u_(u), v_(v) {}
  void Evaluate(double squared, double rho[3]) const override;

 private:
  const RefinementField& field_;
  int u_, v_;
};

/// Holds the pixels of a quad that are not on the object at 0: they share its parameters and touch nothing else.
/// 4 residuals; quads: its own.
class OutsideCost final : public QuadCost {
 public:
  OutsideCost(const RefinementField& field, QuadIndex quad);

 private:
  void evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;
};

enum class Axis { u, v };

/// The quad after this one along an axis.
QuadIndex next_quad(QuadIndex quad, Axis axis);

/// Second differences along an axis that look into this quad and the next one. 4 residuals; quads: these two.
class SmoothnessCost final : public QuadCost {
 public:
  SmoothnessCost(const RefinementField& field, QuadIndex quad, Axis axis, double weight);

 private:
  void evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

  Axis axis_;
  double weight_;
};

/// Slopes change little from the prior's: the differences of a node to its right and lower neighbors against the
/// prior's. 2 residuals; quads: those that hold the three.
class SlopeChangeCost final : public QuadCost {
 public:
  SlopeChangeCost(const RefinementField& field, int u, int v, double weight);

 private:
  void evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

  int u_, v_;
  double weight_;
};

/// Albedo changes little along u and v: ln body − ln shading of a pixel against those of its right and lower
/// neighbors. 2 residuals; quads: those that hold the three pixels' nodes.
class AlbedoCost final : public QuadCost {
 public:
  AlbedoCost(const RefinementField& field, int u, int v);

 private:
  void evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

  int u_, v_;
};

/// Mean of a prior block against the prior's mean, in GSD. 1 residual; quads: those of the block.
class PriorBlockCost final : public QuadCost {
 public:
  PriorBlockCost(const RefinementField& field, int block_column, int block_row);

 private:
  void evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

  int block_column_, block_row_;
  int count_ = 0;
};

}  // namespace malus
