#pragma once

#include "malus/fusion/refine_internal.h"

namespace malus {

/// Refined share of the object below which practically none of the object counts as finer than the prior, and from
/// which on nearly all of it does.
inline constexpr double refined_nowhere = 0.05, refined_everywhere = 0.9;

/// The last round of the course to the result: those of the search change another surface. There must be one.
const RefineIteration& last_round(const RefineReport& report);

/// Whether the last round hardly moved the surface. A surface that still moves is not used as a result.
bool has_settled(const RefineReport& report);

/// Sets the status, warnings and confidence of a refined surface according to the report. `explained_least` is
/// RefineOptions::explained_least.
void judge(const RefineReport& report, double explained_least, FusedSurface& surface);

}  // namespace malus
