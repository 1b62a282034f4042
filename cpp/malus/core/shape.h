#pragma once

#include <Eigen/Core>
#include <string_view>
#include <variant>

#include "malus/core/field_list.h"

namespace malus {

// Surfaces without detail, in the world frame and the station's unit.

struct PlaneShape {
  static constexpr std::string_view name = "plane";
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< of any length and either sign

  MALUS_FIELDS(point, normal)
};

struct SphereShape {
  static constexpr std::string_view name = "sphere";
  Eigen::Vector3d center = Eigen::Vector3d::Zero();
  double radius = 1;

  MALUS_FIELDS(center, radius)
};

/// Circular cylinder of infinite length.
struct CylinderShape {
  static constexpr std::string_view name = "cylinder";
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  ///< on the axis
  Eigen::Vector3d axis = Eigen::Vector3d::UnitY();  ///< of any length
  double radius = 1;

  MALUS_FIELDS(point, axis, radius)
};

using Shape = std::variant<PlaneShape, SphereShape, CylinderShape>;

inline std::string_view name_of(const Shape& shape) {
  return std::visit([](const auto& some) { return some.name; }, shape);
}

}  // namespace malus
