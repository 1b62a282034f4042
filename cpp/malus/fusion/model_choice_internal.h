#pragma once

#include <complex>
#include <optional>

#include "malus/fusion/refinement_internal.h"

namespace malus {

/// Chooses the reflection model of a refinement, at the prior's slopes: which regions are diffuse or specular, or a map
/// of the surroundings, the refractive index, or a metal.
class ModelChoice {
 public:
  explicit ModelChoice(Refinement& refinement) : refinement_(refinement) {}

  /// Decides how each region reflects.
  void label(const RefineInput& input);

  /// Estimates the refractive index from the polarization at the prior's slopes. Uses the estimate if the polarization
  /// clearly contradicts the stated index, or if none is stated.
  void find_index(std::optional<double> stated);

  /// Takes the model that explains more at the prior's slopes: regions that are diffuse or specular, or an object that
  /// is matte all over and mirrors its surroundings. For the second model, the object is taken for a metal if that
  /// explains s0, too, and `may_be_metal`.
  void choose(bool may_be_metal);

  /// Takes the object for the metal that the station file states. What the data say against it is only reported: how
  /// much of the result counts is decided by the evidence, as for any metal.
  void take_metal(std::complex<double> index);

 private:
  double supposed_index() const { return stated_index_.value_or(ReflectionModel().eta); }
  void report_index(bool found, double sigma);
  void leave_out_self_mirroring();
  void correct_index();
  bool take_map(bool may_be_metal, double by_regions);

  Refinement& refinement_;
  std::optional<double> stated_index_;
};

}  // namespace malus
