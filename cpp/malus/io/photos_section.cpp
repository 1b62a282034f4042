#include "malus/io/section_reading_internal.h"
#include "malus/io/station_sections_internal.h"

namespace malus {
namespace {

PhotosSpec read_photos(const TomlTable& table) {
  PhotosSpec spec;
  spec.folder =
      table.resolve("folder", table.required(table.text("folder"), "folder", "the folder of the photographs"));
  if (!std::filesystem::is_directory(spec.folder)) throw table.wrong("folder", "an existing folder");
  spec.exclude = table.texts("exclude").value_or(std::vector<std::string>{});
  if (const auto masks = table.text("masks")) {
    spec.masks = table.resolve("masks", *masks);
    if (!std::filesystem::is_directory(*spec.masks)) throw table.wrong("masks", "an existing folder");
  }
  spec.camera = lens_in(table);
  return spec;
}

}  // namespace

std::optional<PhotosSpec> photos_in(const TomlTable& document) {
  const auto table = document.section("photos", keys_of(PhotosSpec{}));
  return table ? std::optional(read_photos(*table)) : std::nullopt;
}

}  // namespace malus
