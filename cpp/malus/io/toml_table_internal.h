#pragma once

// Private to the io room: a TOML table whose every access is checked and whose errors name file, line, field, value and
// what was expected.

#include <toml++/toml.h>

#include <array>
#include <filesystem>
#include <initializer_list>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "malus/core/error.h"
#include "malus/core/fields.h"

namespace malus {

/// Numbers greater than zero.
inline constexpr Range positive_range{std::numeric_limits<double>::min()};

class TomlTable {
 public:
  /// `name` is how messages call the table: "[polarized]", "[[patch]] 2". Throws for a key that is not `known`.
  TomlTable(const toml::table& table, std::filesystem::path file, std::string name,
            std::initializer_list<std::string_view> known);

  bool has(std::string_view key) const { return table_->contains(key); }
  const toml::node* find(std::string_view key) const { return table_->get(key); }
  /// Whether the key holds the text "auto".
  bool is_auto(std::string_view key) const;

  std::optional<std::string> text(std::string_view key) const;
  std::optional<bool> boolean(std::string_view key) const;
  std::optional<double> number(std::string_view key, Range range = any_value) const;
  std::optional<int> integer(std::string_view key, Range range = any_value) const;
  std::optional<std::vector<double>> numbers(std::string_view key, Range range = any_value) const;
  std::optional<std::vector<std::string>> texts(std::string_view key) const;
  template <std::size_t N>
  std::optional<std::array<double, N>> numbers_exactly(std::string_view key, Range range = any_value) const;
  template <class T>
  T required(std::optional<T> value, std::string_view key, const std::string& expected) const;

  /// Path of a file that exists, is readable and not empty; relative ones start at the station file's folder.
  std::optional<std::filesystem::path> existing_file(std::string_view key) const;
  std::filesystem::path resolve(const std::string& path) const;

  /// Input error "<file>, line L: <table>.<key> = <value>, expected <expected>".
  Error wrong(std::string_view key, const std::string& expected) const;
  /// Input error "<file>, line L: <table>.<key>: <message>".
  Error error(std::string_view key, const std::string& message) const;
  /// "<file>: <table>.<key>", to name the field in messages of other parts.
  std::string where(std::string_view key) const;
  const std::filesystem::path& file() const { return file_; }

 private:
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

template <class T>
T TomlTable::required(std::optional<T> value, std::string_view key, const std::string& expected) const {
  if (!value) throw error(key, "is missing, expected " + expected);
  return std::move(*value);
}

}  // namespace malus
