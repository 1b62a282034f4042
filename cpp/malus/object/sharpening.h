#pragma once

#include <span>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/object/view.h"

namespace malus {

/// Polarization of a station: its degree times cosine and sine of twice its phase; zero where it is not known.
struct PhaseMaps {
  Image<float> cosine, sine;
};

/// From degree and phase (rad) of every pixel (PolarizationState::rho and phi); NaN = not known.
PhaseMaps phase_maps(const Image<float>& degree, const Image<float>& phase);

/// A station whose phases say how surfaces are inclined. It owns no pixels: cosine and sine as in PhaseMaps.
struct PhasedView {
  ObjectView view;
  PixelSpan<float> cosine, sine;
};

/// Whether enough of a station's phases are consistent with its own surface. Only such stations may sharpen others.
bool is_telling(const PhasedView& station, const Context& context);

/// The rasters of a view that sharpening changes (see ObjectView); `usable` stays as it is.
struct SharpenedMaps {
  Image<float> depth, normals;
};

/// Restores detail that stereo smoothed away in a view, as far as the phases of several stations support it.
///
/// A phase of polarization constrains the surface normal to a plane through the viewing ray: for diffuse reflection the
/// plane with the phase's direction, for specular reflection the plane across it (multi-view azimuth stereo: Cao et al.
/// 2023). Every station that sees a place constrains its normal in this way, whatever the station's prior. The depths
/// of the view are moved slightly and smoothly, so that as many normals as possible lie in their planes. This is done
/// in tiles, since a move has no effect far beyond a tile. Without stations nothing is moved.
SharpenedMaps sharpened(const ObjectView& view, std::span<const PhasedView> stations, const Context& context);

}  // namespace malus
