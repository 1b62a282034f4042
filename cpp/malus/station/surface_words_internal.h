#pragma once

// Private to the station room: what every file of a surface says of it, so that whoever gets only the file knows.

#include "malus/station/json_fields_internal.h"

namespace malus {

/// The words by their names, of one line each, none empty: title and the rest of [object], unit, pixel, confidence, its
/// reasons, how much of the surface is finer than the prior, the program. `quality` is what quality.json says, of which
/// name, object, unit, gsd, confidence and refinement are asked.
Json surface_words(const Json& quality);

/// The same with numbers, for asset.extras of a GLB file; `versions` are those of the libraries.
Json surface_extras(const Json& quality, const Json& versions);

/// Of this library and of those that compute, by their names.
Json all_versions();

}  // namespace malus
