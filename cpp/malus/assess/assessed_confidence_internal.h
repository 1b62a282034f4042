#pragma once

#include "malus/assess/quality_internal.h"
#include "malus/core/confidence.h"
#include "malus/core/context.h"

namespace malus {

/// Whether a pixel is the object's, by the first of what the input has: mask, polarization, any depth.
bool is_object(const AssessInput& input, std::size_t pixel);

/// Share of the surface whose depth is within two standard deviations of the prior's; NaN without the latter.
double share_within_prior(const FusedSurface& surface, const DepthPrior& prior, const Context& context);

/// How far the surface may be trusted: what the fusion says of its own result, limited by what surface, prior and
/// polarization show beside each other. Neither options nor patches, profiles and reference have a part in it, so that
/// the files of the surface can say it before those are known.
Confidence assessed_confidence(const AssessInput& input, const Context& context);

}  // namespace malus
