#include <cmath>

#include "malus/core/metal_internal.h"
#include "malus/core/refractive_index_internal.h"
#include "malus/io/station_sections_internal.h"

namespace malus {
namespace {

/// The metal as one text: a list [n, k] becomes "n+ki".
MetalStatement read_metal(const TomlTable& table) {
  const toml::node* const node = table.find("metal");
  if (node == nullptr) return {};
  std::string text;
  if (node->is_string()) text = *table.text("metal");
  if (node->is_array()) {
    const std::array<double, 2> index = *table.numbers_exactly<2>("metal");
    text = metal_index_text(index[0], index[1]);
  }
  std::optional<MetalStatement> metal = read_metal_statement(text);
  if (!metal) throw table.wrong("metal", expected_metal());
  return *metal;
}

/// Sets the kind of reflection: a word, or the file of a label image.
void read_reflection(const TomlTable& table, OpticsSpec& spec) {
  const std::string reflection = table.text("reflection").value_or("auto");
  const auto choice = enum_value<ReflectionChoice>(reflection);
  if (choice && *choice != ReflectionChoice::labels) {
    spec.reflection = *choice;
    return;
  }
  if (!std::filesystem::exists(table.resolve("reflection", reflection))) {
    throw table.wrong("reflection", "\"diffuse\", \"specular\", \"auto\" or the file of a label image");
  }
  spec.label_image = table.existing_file("reflection");
  spec.reflection = ReflectionChoice::labels;
}

}  // namespace

OpticsSpec read_optics(const TomlTable& document, const GivenInMemory* given) {
  OpticsSpec spec;
  const auto section = document.section("optics", {"refractive_index", "reflection", "light", "metal"});
  if (!section) return spec;
  const TomlTable& table = *section;
  if (table.is_auto("refractive_index")) {
    spec.refractive_index.reset();
  } else {
    spec.refractive_index = table.number("refractive_index", {least_refractive_index, largest_refractive_index})
                                .value_or(*spec.refractive_index);
  }
  spec.light = table.numbers_exactly<3>("light");
  if (spec.light && !(std::hypot((*spec.light)[0], (*spec.light)[1], (*spec.light)[2]) > 0 && (*spec.light)[2] < 0))
    throw table.wrong("light", "a direction [x, y, z] towards the source with z < 0, on the camera's side");
  read_reflection(table, spec);
  const MetalStatement metal = read_metal(table);
  const bool has_labels = given != nullptr && given->has_labels;
  const auto expected = expected_metal_with(metal, has_labels ? ReflectionChoice::labels : spec.reflection);
  if (expected) throw table.wrong("metal", *expected);
  spec.metal = metal.text;
  return spec;
}

}  // namespace malus
