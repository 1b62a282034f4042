#pragma once

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "malus/core/camera.h"
#include "malus/core/pose.h"

namespace malus::python {

/// model, width, height, params, rotation, translation of a malus.Camera.
using CameraValues = std::tuple<std::string, int, int, std::vector<double>, Eigen::Matrix3d, Eigen::Vector3d>;

/// Lens and pose of a malus.Camera, checked; `name` is for messages.
inline std::pair<LensCamera, Pose> to_camera(const CameraValues& values, const std::string& name) {
  const auto& [model, width, height, params, rotation, translation] = values;
  LensCamera camera{lens_model(model, name + ".model"), {width, height}, params};
  camera.validate(name);
  return {std::move(camera), {rotation, translation}};
}

inline CameraValues to_values(const LensCamera& camera, const Pose& pose) {
  return {std::string(to_string(camera.model)),
          camera.size.width,
          camera.size.height,
          camera.params,
          pose.rotation,
          pose.translation};
}

}  // namespace malus::python
