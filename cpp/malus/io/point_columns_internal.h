#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace malus {

/// Meaning of a column of a text or of a property of a PLY.
enum PointSlot : std::size_t {
  slot_x,
  slot_y,
  slot_z,
  slot_nx,
  slot_ny,
  slot_nz,
  slot_red,
  slot_green,
  slot_blue,
  slot_count
};

/// Names of each slot in files, in lower case; the first is used in messages.
inline constexpr std::array<std::array<std::string_view, 4>, slot_count> slot_names{{{"x"},
                                                                                     {"y"},
                                                                                     {"z"},
                                                                                     {"nx", "normal_x"},
                                                                                     {"ny", "normal_y"},
                                                                                     {"nz", "normal_z"},
                                                                                     {"red", "r", "diffuse_red"},
                                                                                     {"green", "g", "diffuse_green"},
                                                                                     {"blue", "b", "diffuse_blue"}}};

/// Slot of a property or column name, or slot_count.
std::size_t slot_of(const std::string& name);

/// The values of one point by slot.
using PointValues = std::array<double, slot_count>;

/// Which column of a text or property of a PLY holds which slot.
struct PointColumns {
  std::array<std::optional<std::size_t>, slot_count> column{};

  bool has_three(std::size_t slot) const { return column[slot] && column[slot + 1] && column[slot + 2]; }
  void set_three(std::size_t slot, std::size_t first) {
    for (std::size_t i = 0; i < 3; ++i) column[slot + i] = first + i;
  }
  /// The number of columns that a line must have.
  std::size_t count() const {
    std::size_t least = 0;
    for (const auto& index : column) least = std::max(least, index ? *index + 1 : 0);
    return least;
  }
  PointValues point(const std::vector<double>& values) const {
    PointValues found{};
    for (std::size_t slot = 0; slot < slot_count; ++slot) {
      if (column[slot]) found[slot] = values[*column[slot]];
    }
    return found;
  }
};

}  // namespace malus
