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

/// The station's labels in the undistorted view, empty without any. Like the mask they are of the images as taken.
inline Mask labels_in_view(const Station& station, const Context& context) {
  const Mask labels = captured_labels(station);
  return labels.empty() ? labels : undistorted_mask(labels, station.file.known_lens(), context);
}

}  // namespace malus
