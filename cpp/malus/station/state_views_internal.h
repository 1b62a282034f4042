#pragma once

// Private to the station room: quantities that several steps derive from the polarization or the station.

#include "malus/capture/capture_internal.h"
#include "malus/core/camera.h"
#include "malus/lighting/light_internal.h"
#include "malus/polarization/polarization_state.h"
#include "malus/station/check_inputs_internal.h"
#include "malus/station/station.h"

namespace malus {

/// The light estimated from the valid pixels of a surface with these normals.
inline LightEstimate light_on_surface(const PolarizationState& state, const Image<float>& normals,
                                      const Pinhole* camera, const LightOptions& options, const Context& context) {
  return estimate_light(state.i_un, normals, state.valid_pixels(), camera, options, context);
}

/// The station's label image in the undistorted view, empty without one. Like the mask it is of the images as captured.
inline Image<std::uint8_t> labels_in_view(const StationFile& station, const Context& context) {
  if (!station.optics.label_image) return {};
  return undistorted_mask(captured_labels(station), station.known_lens(), context);
}

}  // namespace malus
