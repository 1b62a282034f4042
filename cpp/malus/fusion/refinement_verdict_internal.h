#pragma once

#include "malus/fusion/refine_internal.h"

namespace malus {

/// Whether the last round hardly moved the surface. A surface that still moves is not used as a result.
bool has_settled(const RefineReport& report);

/// Sets the status, warnings and confidence of a refined surface according to the report. `explained_least` is
/// RefineOptions::explained_least.
void judge(const RefineReport& report, double explained_least, FusedSurface& surface);

}  // namespace malus
