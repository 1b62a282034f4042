#include <algorithm>

#include "malus/io/colmap_workspace_internal.h"
#include "malus/io/section_reading_internal.h"
#include "malus/io/station_sections_internal.h"

namespace malus {
namespace {

/// Keys of a prior's surface.
const Keys surface_keys{"cloud", "mesh", "depth", "plane", "sphere", "cylinder"};

constexpr Range coordinate_range{-1e12, 1e12}, length_range{1e-12, 1e12};

Eigen::Vector3d read_point(const TomlTable& table, std::string_view key) {
  const auto values =
      table.required(table.numbers_exactly<3>(key, coordinate_range), key, "three coordinates, [x, y, z]");
  return {values[0], values[1], values[2]};
}

Eigen::Vector3d read_direction(const TomlTable& table, std::string_view key) {
  const Eigen::Vector3d direction = read_point(table, key);
  if (!(direction.norm() > 0)) throw table.wrong(key, "a direction, not all zero");
  return direction;
}

double read_radius(const TomlTable& table) {
  return table.required(table.number("radius", length_range), "radius", "a length in the station's unit");
}

/// [prior].plane, .sphere or .cylinder; nothing without them.
std::optional<Shape> read_shape(const TomlTable& table) {
  if (const auto plane = table.section("plane", keys_of(PlaneShape{})))
    return PlaneShape{read_point(*plane, "point"), read_direction(*plane, "normal")};
  if (const auto sphere = table.section("sphere", keys_of(SphereShape{})))
    return SphereShape{read_point(*sphere, "center"), read_radius(*sphere)};
  if (const auto cylinder = table.section("cylinder", keys_of(CylinderShape{}))) {
    return CylinderShape{read_point(*cylinder, "point"), read_direction(*cylinder, "axis"), read_radius(*cylinder)};
  }
  return std::nullopt;
}

/// File or shape of [prior]; nothing if the surface itself is in memory.
std::optional<PriorFile> read_surface(const TomlTable& table, bool in_memory) {
  const auto given = std::ranges::count_if(surface_keys, [&](std::string_view key) { return table.has(key); });
  if (given == 0 && in_memory) return std::nullopt;
  if (given != 1) {
    throw table.error("cloud", "[prior] has " + std::to_string(given) +
                                   " surfaces, expected exactly one of cloud, mesh, depth, plane, sphere and cylinder");
  }
  if (const std::optional<Shape> shape = read_shape(table)) {
    if (!table.has("sigma")) {
      throw table.error("sigma", "is missing, expected how far the object is from the " + std::string(name_of(*shape)) +
                                     ", one standard deviation in the station's unit");
    }
    return *shape;
  }
  if (table.has("mesh")) return MeshFile{*table.existing_file("mesh")};
  if (table.has("depth")) return DepthFile{*table.existing_file("depth")};
  const std::filesystem::path folder = table.resolve("cloud", *table.text("cloud"));
  if (!std::filesystem::is_directory(folder)) return CloudFile{*table.existing_file("cloud")};
  try {
    colmap_workspace_files(folder);
  } catch (const Error& error) {
    throw table.error("cloud", std::string("is a folder, but no COLMAP dense workspace: ") + error.what());
  }
  return CloudFile{folder};
}

}  // namespace

void read_prior(const TomlTable& document, bool in_memory, StationFile& station) {
  const auto table = document.section("prior", joined({surface_keys, {"sigma"}}));
  if (!table) return;
  station.prior = read_surface(*table, in_memory);
  station.prior_sigma = table->number("sigma", length_range);
}

Shape read_shape_table(const toml::table& root) {
  const TomlTable table(root, "shape", "[prior]", {PlaneShape::name, SphereShape::name, CylinderShape::name});
  if (root.size() != 1) {
    throw input_error("shape: " + std::to_string(root.size()) +
                      " shapes, expected exactly one of plane, sphere and cylinder");
  }
  return *read_shape(table);
}

}  // namespace malus
