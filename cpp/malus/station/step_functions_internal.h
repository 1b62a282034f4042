#pragma once

// Private to the station room: what the steps do. A function takes the results that the step reads, and returns those
// that it makes.

#include <tuple>

#include "malus/station/step_internal.h"

namespace malus {

// polarization_steps.cpp: what the images say.

/// Angles and exposures that the images themselves ask for are fitted where that is wanted and better than what is
/// given.
std::tuple<MeasuredPolarization, StationView, ObjectColor, Scene, ImageFindings> measure_polarization(const Job& job);
/// Corrects the polarizer's scale by the surface: images alone cannot tell its zero.
CalibratedPolarization calibrate_polarization(const Job& job, const MeasuredPolarization& measured,
                                              const StationView& view, const DepthPrior* prior);
/// Diffuse or specular, and the zenith that the degree then means.
std::tuple<ReflectionMap, ClampedZeniths> find_zenith(const Job& job, const CalibratedPolarization& polarization,
                                                      const StationView& view, const DepthPrior* prior);

// evidence_step.cpp

/// What is wrong with the inputs, as far as they tell. Throws what is certain, unless `evidence.refuse` is off.
InputEvidence check_inputs(const Job& job, const ImageFindings& of_images, const CalibratedPolarization& polarization,
                           const StationView& view, const Scene& scene, const DepthPrior* prior);

// surface_steps.cpp: what stereo and both together say.

/// What stereo says, seen from the station.
std::tuple<DepthPrior, PriorPoints> make_prior(const Job& job, const MeasuredPolarization& measured,
                                               const StationView& view);
/// The paper's height from polarization alone (Eq 9 to 11). Without a prior its light is the station's, or found by
/// light_from_polarization.
HeightMap make_height(const Job& job, const CalibratedPolarization& polarization, const StationView& view,
                      const DepthPrior* prior, const ReflectionMap& reflection);
/// One surface of both: the paper's grid transfer (Eq 14 to 16), and all equations together from there on if asked for.
/// Nothing is fused before its inputs are checked.
FusedSurface fuse_by_grid(const Job& job, const HeightMap& height, const DepthPrior& prior,
                          const CalibratedPolarization& polarization, const ReflectionMap& reflection,
                          const InputEvidence& evidence);
/// The same by nonlinear refinement.
std::tuple<FusedSurface, RefinementFindings> fuse_by_refinement(const Job& job,
                                                                const CalibratedPolarization& polarization,
                                                                const DepthPrior& prior, const InputEvidence& evidence);
/// The files in which people take the surface to other programs; the meshes say unit, confidence and the words of
/// [object]. A surface that has no elevation model (its plane is seen edge-on) goes without dem.tif, with a warning.
void write_mesh(const Job& job, const FusedSurface& surface, const ObjectColor& color,
                const CalibratedPolarization& polarization, const DepthPrior& prior,
                const RefinementFindings* refinement);

// assess_step.cpp

/// Every figure of quality.json.
QualityReport make_quality(const Job& job, const FusedSurface& surface, const CalibratedPolarization& polarization,
                           const StationView& view, const DepthPrior& prior, const ClampedZeniths* clamped,
                           const HeightMap* height, const RefinementFindings* refinement, const Warnings& warnings);

}  // namespace malus
