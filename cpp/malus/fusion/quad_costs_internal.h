#pragma once

#include <ceres/cost_function.h>
#include <ceres/loss_function.h>

#include <vector>

#include "malus/fusion/refinement_field_internal.h"

namespace malus {

// Ceres gets the unknowns in quads: parameter blocks of 2 × 2 nodes (order: (0,0), (1,0), (0,1), (1,1)). Blocks of four
// keep Ceres' bookkeeping (cells, products, ordering) small beside the arithmetic. A cost joins only neighboring quads,
// diagonal neighbors included, and the prior's cost the quads of its block: the elimination order relies on this.
// Weights and log_body are read from the field, which must not change during a solve.

inline constexpr int quad_px = 2;

/// A quad by its position in units of quads.
struct QuadIndex {
  int column = 0, row = 0;
  bool operator==(const QuadIndex&) const = default;
};

/// Calls visit(u, v, i) for the quad's nodes that are on the object; i is the node's place in the parameter block.
template <class Visit>
void for_each_node(const RefinementField& field, QuadIndex quad, Visit&& visit) {
  for (int i = 0; i < quad_px * quad_px; ++i) {
    const int u = quad_px * quad.column + i % quad_px, v = quad_px * quad.row + i / quad_px;
    if (field.is_object(u, v)) visit(u, v, i);
  }
}

/// Number of the quad's nodes that are on the object.
int nodes_on_object(const RefinementField& field, QuadIndex quad);

/// Cost function over those of the given quads that hold a node of the object; `quads()` are its parameter blocks, in
/// order.
class QuadCost : public ceres::CostFunction {
 public:
  const std::vector<QuadIndex>& quads() const { return quads_; }

  /// From this call on, evaluates to zeros while `*finished` is true.
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

/// Stokes residuals of one pixel in standard deviations. 2 residuals, for a metal 3 (with s0); quads: those that hold
/// the pixel's four nodes.
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

/// Holds the nodes of a quad that are not on the object at 0: they are part of the quad's parameter block, but in no
/// other cost.
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

/// Second differences, along an axis, of the change from the prior within this quad and the next one. 4 residuals;
/// quads: these two.
class SmoothnessCost final : public QuadCost {
 public:
  SmoothnessCost(const RefinementField& field, QuadIndex quad, Axis axis, double weight);

 private:
  void evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

  Axis axis_;
  double weight_;
};

/// Keeps slopes near the prior's: the differences of a node to its right and lower neighbors minus the same differences
/// of the prior. 2 residuals; quads: those that hold the three nodes.
class SlopeChangeCost final : public QuadCost {
 public:
  SlopeChangeCost(const RefinementField& field, int u, int v, double weight);

 private:
  void evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

  int u_, v_;
  double weight_;
};

/// Keeps the albedo of neighboring pixels alike: ln body − ln shading of a pixel minus that of its right and of its
/// lower neighbor. 2 residuals; quads: those that hold the three pixels' nodes.
class AlbedoCost final : public QuadCost {
 public:
  AlbedoCost(const RefinementField& field, int u, int v);

 private:
  void evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

  int u_, v_;
};

/// Mean of x over a prior block minus the prior's mean, in GSD. 1 residual; quads: those of the block.
class PriorBlockCost final : public QuadCost {
 public:
  PriorBlockCost(const RefinementField& field, int block_column, int block_row);

 private:
  void evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

  int block_column_, block_row_;
  int count_ = 0;
};

}  // namespace malus
