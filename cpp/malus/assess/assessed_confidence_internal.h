#pragma once

#include "malus/assess/quality_internal.h"
#include "malus/core/confidence.h"
#include "malus/core/context.h"

namespace malus {

/// Whether a pixel is on the object: as the polarization says, or, without a polarization, if any surface has a depth
/// there.
bool is_object(const AssessInput& input, std::size_t pixel);

/// Share of the object's pixels with usable polarization; NaN without an object. The input must have a polarization.
double usable_share(const AssessInput& input, const Context& context);

/// Share of the surface whose depth is within two standard deviations of the prior's; NaN if the prior has no standard
/// deviations.
double share_within_prior(const FusedSurface& surface, const DepthPrior& prior, const Context& context);

/// Limits the confidence of a surface whose standard deviation is more than 10 GSD: it has no reliable detail.
void limit_by_sigma_gsd(double sigma_gsd, Confidence& confidence);

/// How far the surface may be trusted: the fusion's own confidence, limited by a comparison of surface, prior and
/// polarization. It does not depend on options, patches, profiles or the reference, so that the surface's files can
/// state it before those are evaluated.
Confidence assessed_confidence(const AssessInput& input, const Context& context);

}  // namespace malus
