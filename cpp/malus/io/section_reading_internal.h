#pragma once

// Private to the io room: what the readers of a station file's sections share.

#include <array>
#include <concepts>
#include <initializer_list>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "malus/io/station_spec.h"
#include "malus/io/toml_library_internal.h"
#include "malus/io/toml_table_internal.h"

namespace malus {

using Keys = std::vector<std::string_view>;

/// All keys of the lists, in their order.
Keys joined(std::initializer_list<Keys> lists);

/// Keys of a spec's fields, and `keys`, which only the file has.
template <class Spec>
Keys keys_of(const Spec& spec, Keys keys = {}) {
  Spec::fields(spec, [&keys](std::string_view key, const auto&...) { keys.push_back(key); });
  return keys;
}

/// Sets the fields that have no form of their own; those without a range may have any value.
template <class Spec>
void read_fields(const TomlTable& table, Spec& spec) {
  Spec::fields(spec, [&table](std::string_view key, auto& value, const auto&... range) {
    if constexpr ((std::convertible_to<decltype(range), Range> && ...)) table.read(key, value, Range(range...));
  });
}

/// Throws the error `why` for the first of the keys that the table has.
void refuse(const TomlTable& table, const Keys& keys, const std::string& why);

/// The pairs of a list such as [[90, 45], [135, 0]]; nothing unless it is a list of pairs of finite numbers.
std::optional<std::vector<std::array<double, 2>>> pairs_of(const toml::node& node);

/// Name of a control point, patch or profile, by default its number, `index` + 1. Throws an input error if `names` has
/// it already; adds it to them.
std::string read_name(const TomlTable& table, std::size_t index, std::set<std::string>& names);

/// Marks in photos; without them, in images of the camera's model. None without the key. Throws an input error for
/// incomplete marks, two marks in one image, and photos that do not exist.
std::vector<ImageMark> read_marks(const TomlTable& table, std::string_view key,
                                  const std::optional<PhotosSpec>& photos);

}  // namespace malus
