#include <algorithm>
#include <cmath>

#include "malus/io/input_file_internal.h"
#include "malus/io/section_reading_internal.h"

namespace malus {

Keys joined(std::initializer_list<Keys> lists) {
  Keys all;
  for (const Keys& keys : lists) all.insert(all.end(), keys.begin(), keys.end());
  return all;
}

void refuse(const TomlTable& table, const Keys& keys, const std::string& why) {
  const auto found = std::ranges::find_if(keys, [&table](std::string_view key) { return table.has(key); });
  if (found != keys.end()) throw table.error(*found, why);
}

std::optional<std::vector<std::array<double, 2>>> pairs_of(const toml::node& node) {
  if (!node.is_array()) return std::nullopt;
  std::vector<std::array<double, 2>> pairs;
  for (const toml::node& row : *node.as_array()) {
    if (!row.is_array() || row.as_array()->size() != 2) return std::nullopt;
    std::array<double, 2>& pair = pairs.emplace_back();
    for (std::size_t i = 0; i < 2; ++i) {
      const toml::node& number = (*row.as_array())[i];
      const std::optional<double> value = number.is_number() ? number.value<double>() : std::nullopt;
      if (!value || !std::isfinite(*value)) return std::nullopt;
      pair[i] = *value;
    }
  }
  return pairs;
}

std::string read_name(const TomlTable& table, std::size_t index, std::set<std::string>& names) {
  const std::string name = table.text("name").value_or(std::to_string(index + 1));
  if (!names.insert(name).second) throw table.error("name", "\"" + name + "\" appears twice, expected different names");
  return name;
}

std::vector<ImageMark> read_marks(const TomlTable& table, std::string_view key,
                                  const std::optional<PhotosSpec>& photos) {
  std::vector<ImageMark> marks;
  std::set<std::string> images;
  const std::string expected = "a list of marks { image = \"…\", x = …, y = … }";
  for (const TomlTable& mark : table.tables(key, keys_of(ImageMark{}), expected)) {
    ImageMark result;
    result.image = mark.required(mark.text("image"), "image", "the name of a photo");
    result.x = mark.required(mark.number("x"), "x", "the column in pixels");
    result.y = mark.required(mark.number("y"), "y", "the row in pixels");
    if (photos) require_file(photos->folder / result.image, mark.where("image"));
    if (!images.insert(result.image).second) throw mark.wrong("image", "one mark a photo");
    marks.push_back(std::move(result));
  }
  return marks;
}

}  // namespace malus
