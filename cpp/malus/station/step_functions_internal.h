#pragma once

// Private to the station room: the steps' functions. A function takes the results that the step reads, and returns
// those that it makes.

#include <tuple>

#include "malus/station/step_internal.h"

namespace malus {

// polarization_steps.cpp: from the images.

/// Fits polarizer angles and exposures to the images where the options ask for it. Unless the options force them, they
/// are used only if they are clearly better than the given ones.
std::tuple<MeasuredPolarization, StationView, ObjectColor, Scene, ImageFindings> measure_polarization(const Job& job);
/// Corrects the polarizer's scale by the surface: images alone do not determine its zero.
CalibratedPolarization calibrate_polarization(const Job& job, const MeasuredPolarization& measured,
                                              const StationView& view, const DepthPrior* prior);
/// Classifies pixels as diffuse or specular, and computes the zenith from the degree of polarization.
std::tuple<ReflectionMap, ClampedZeniths> find_zenith(const Job& job, const CalibratedPolarization& polarization,
                                                      const StationView& view, const DepthPrior* prior);

// evidence_step.cpp

/// Findings about wrong inputs. Throws for errors that are certain, unless `evidence.refuse` is off.
InputEvidence check_inputs(const Job& job, const ImageFindings& of_images, const CalibratedPolarization& polarization,
                           const StationView& view, const Scene& scene, const DepthPrior* prior);

// surface_steps.cpp: from stereo, and from stereo and polarization together.

/// The coarse surface in the station's view.
std::tuple<DepthPrior, PriorPoints> make_prior(const Job& job, const MeasuredPolarization& measured,
                                               const StationView& view);
/// The paper's height from polarization alone (Eq 9 to 11). The light is the station's if given. Otherwise it is
/// estimated on the prior's surface, or without a prior by light_from_polarization.
HeightMap make_height(const Job& job, const CalibratedPolarization& polarization, const StationView& view,
                      const DepthPrior* prior, const ReflectionMap& reflection);
/// Fuses prior and height by the paper's grid transfer (Eq 14 to 16), followed by the solution of all equations
/// together if `optimize.enabled`. Reads `evidence`, so that inputs are always checked before they are fused.
FusedSurface fuse_by_grid(const Job& job, const HeightMap& height, const DepthPrior& prior,
                          const CalibratedPolarization& polarization, const ReflectionMap& reflection,
                          const InputEvidence& evidence);
/// Fuses prior and polarization by nonlinear refinement.
std::tuple<FusedSurface, RefinementFindings> fuse_by_refinement(const Job& job,
                                                                const CalibratedPolarization& polarization,
                                                                const DepthPrior& prior, const InputEvidence& evidence);
/// Files for use in other programs. The meshes state unit, confidence and the fields of [object]. If the surface has no
/// elevation model (its plane is seen edge-on), dem.tif is left out with a warning.
void write_mesh(const Job& job, const FusedSurface& surface, const ObjectColor& color,
                const CalibratedPolarization& polarization, const DepthPrior& prior,
                const RefinementFindings* refinement);

// assess_step.cpp

/// Computes every figure of quality.json.
QualityReport make_quality(const Job& job, const FusedSurface& surface, const CalibratedPolarization& polarization,
                           const StationView& view, const DepthPrior& prior, const ClampedZeniths* clamped,
                           const HeightMap* height, const RefinementFindings* refinement, const Warnings& warnings);

}  // namespace malus
