#pragma once

// Private to the station room: metadata in every file of a surface, for people who get only that file.

#include <optional>

#include "malus/station/json_fields_internal.h"

namespace malus {

/// Share of the object where the surface is finer than its prior, 0 … 1; nothing if the run did not determine it.
/// `quality` is the content of quality.json, of which polarization and refinement are used.
std::optional<double> refined_share(const Json& quality);

/// The metadata by name, one line each, none empty: title and the other fields of [object], unit, pixel, confidence,
/// its reasons, how much of the surface is finer than the prior, the program. `quality` is the content of quality.json,
/// of which name, object, unit, gsd, confidence, polarization and refinement are used.
Json surface_words(const Json& quality);

/// The same with numbers, for asset.extras of a GLB file; `versions` is from all_versions.
Json surface_extras(const Json& quality, const Json& versions);

/// Versions of this library and of the libraries that it computes with, by name.
Json all_versions();

}  // namespace malus
