#pragma once

// Private to the io room: a TOML table whose every access is checked and whose errors name file, line, field, value and
// what was expected.

#include <array>
#include <concepts>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "malus/core/error.h"
#include "malus/core/fields.h"
#include "malus/io/station_spec.h"
#include "malus/io/toml_library_internal.h"

namespace malus {

class TomlTable {
 public:
  /// `name` is the table's name in messages: "[polarized]", "[[patch]] 2". Throws for a key that is not `known`.
  TomlTable(const toml::table& table, std::filesystem::path file, std::string name,
            const std::vector<std::string_view>& known);

  bool has(std::string_view key) const { return table_->contains(key); }
  const toml::node* find(std::string_view key) const { return table_->get(key); }
  /// Whether the key holds the text "auto".
  bool is_auto(std::string_view key) const;

  /// One line without control characters, because line-based formats could not hold a line break.
  std::optional<std::string> text(std::string_view key) const;
  /// Text of any number of lines.
  std::optional<std::string> lines(std::string_view key) const;
  std::optional<bool> boolean(std::string_view key) const;
  std::optional<double> number(std::string_view key, Range range = any_value) const;
  std::optional<int> integer(std::string_view key, Range range = any_value) const;
  std::optional<std::vector<double>> numbers(std::string_view key, Range range = any_value) const;
  std::optional<std::vector<std::string>> texts(std::string_view key) const;
  template <std::size_t N>
  std::optional<std::array<double, N>> numbers_exactly(std::string_view key, Range range = any_value) const;
  /// One of these texts.
  std::optional<std::string> text_among(std::string_view key, std::span<const std::string_view> known) const;
  /// One of the enum's names.
  template <NamedEnum T>
  std::optional<T> choice(std::string_view key) const;
  /// Sets the value of a spec's field if the table has its key.
  template <class T>
  void read(std::string_view key, T& value, Range range) const;
  template <class T>
  T required(std::optional<T> value, std::string_view key, const std::string& expected) const;

  /// The table of this key, or nothing; its keys must be `known`.
  std::optional<TomlTable> section(std::string_view key, const std::vector<std::string_view>& known) const;
  /// The tables of an array such as [[scale]]; `expected` is for the message if it is something else.
  std::vector<TomlTable> tables(std::string_view key, const std::vector<std::string_view>& known,
                                const std::string& expected) const;

  /// Path of a file that exists, is readable and not empty; relative paths start at the station file's folder.
  std::optional<std::filesystem::path> existing_file(std::string_view key) const;
  /// The path that the key names. The file need not exist, but the system must be able to look it up: names that are
  /// too long, cycles of links and folders without permission are errors.
  std::filesystem::path resolve(std::string_view key, const std::string& path) const;

  /// Input error "<file>, line L: <table>.<key> = <value>, expected <expected>".
  Error wrong(std::string_view key, const std::string& expected) const;
  /// Input error "<file>, line L: <table>.<key>: <message>".
  Error error(std::string_view key, const std::string& message) const;
  /// "<file>: <table>.<key>", to name the field in messages from other code.
  std::string where(std::string_view key) const;
  const std::filesystem::path& file() const { return file_; }

 private:
  /// "<table>.<key>"
  std::string full_name(std::string_view key) const;
  std::string place(std::string_view key) const;

  const toml::table* table_;
  std::filesystem::path file_;
  std::string name_;
};

template <std::size_t N>
std::optional<std::array<double, N>> TomlTable::numbers_exactly(std::string_view key, Range range) const {
  const auto list = numbers(key, range);
  if (!list) return std::nullopt;
  if (list->size() != N) throw wrong(key, "a list of " + std::to_string(N) + " numbers");
  std::array<double, N> result{};
  std::copy(list->begin(), list->end(), result.begin());
  return result;
}

template <NamedEnum T>
std::optional<T> TomlTable::choice(std::string_view key) const {
  const auto names = names_of(T{});
  const auto name = text_among(key, names);
  return name ? enum_value<T>(*name) : std::nullopt;
}

template <class T>
void TomlTable::read(std::string_view key, T& value, Range range) const {
  if constexpr (NamedEnum<T>) {
    value = choice<T>(key).value_or(value);
  } else if constexpr (std::same_as<T, bool>) {
    value = boolean(key).value_or(value);
  } else if constexpr (std::same_as<T, int>) {
    value = integer(key, range).value_or(value);
  } else if constexpr (std::same_as<T, double>) {
    value = number(key, range).value_or(value);
  } else if constexpr (std::same_as<T, std::optional<double>>) {
    value = number(key, range);
  } else if constexpr (std::same_as<T, std::optional<std::string>>) {
    value = lines(key);
  } else {
    static_assert(std::same_as<T, std::optional<std::filesystem::path>>, "fields of other types have an own form");
    value = existing_file(key);
  }
}

template <class T>
T TomlTable::required(std::optional<T> value, std::string_view key, const std::string& expected) const {
  if (!value) throw error(key, "is missing, expected " + expected);
  return std::move(*value);
}

}  // namespace malus
