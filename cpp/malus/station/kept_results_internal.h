#pragma once

// Private to the station room: the files and notes in which a workspace stores each step's results.

#include "malus/station/keeper_internal.h"
#include "malus/station/results.h"

namespace malus {

// Each function names all parts of a result, to write them or to read them back (see Keeper).

void keep(MeasuredPolarization& result, Keeper& keeper);
void keep(StationView& result, Keeper& keeper);
void keep(ImageFindings& result, Keeper& keeper);
void keep(ObjectColor& result, Keeper& keeper);
void keep(Scene& result, Keeper& keeper);
void keep(CalibratedPolarization& result, Keeper& keeper);
void keep(InputEvidence& result, Keeper& keeper);
void keep(DepthPrior& result, Keeper& keeper);
void keep(PriorPoints& result, Keeper& keeper);
void keep(ReflectionMap& result, Keeper& keeper);
void keep(ClampedZeniths& result, Keeper& keeper);
void keep(HeightMap& result, Keeper& keeper);
void keep(FusedSurface& result, Keeper& keeper);
void keep(RefinementFindings& result, Keeper& keeper);
void keep(QualityReport& result, Keeper& keeper);

}  // namespace malus
