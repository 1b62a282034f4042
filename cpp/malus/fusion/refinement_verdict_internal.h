#pragma once

#include "malus/fusion/refine_internal.h"

namespace malus {

/// Whether the last round left the surface about where it was. One that still moves is no result.
bool has_settled(const RefineReport& report);

/// Says of a refined surface what the report gives reason for: status, warnings and confidence. `explained_least` is
/// RefineOptions::explained_least.
void judge(const RefineReport& report, double explained_least, FusedSurface& surface);

}  // namespace malus
