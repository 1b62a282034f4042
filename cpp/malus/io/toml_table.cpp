#include <algorithm>
#include <cmath>
#include <sstream>
#include <string_view>
#include <system_error>

#include "malus/core/digits_internal.h"
#include "malus/io/input_file_internal.h"
#include "malus/io/nearest_name_internal.h"
#include "malus/io/toml_table_internal.h"

namespace malus {
namespace {

/// The value as written in the file, cut when it is long.
std::string value_text(const toml::node& node) {
  if (const auto* number = node.as_floating_point()) return shortest_text(number->get());
  std::ostringstream stream;
  node.visit([&](const auto& value) { stream << value; });
  std::string text = stream.str();
  std::replace(text.begin(), text.end(), '\n', ' ');
  constexpr std::size_t longest = 80;
  return text.size() <= longest ? text : text.substr(0, longest) + " …";
}

constexpr std::string_view line_ends = "\n\r";

/// Control characters, which XML cannot hold and terminals take for commands. Bytes of multibyte UTF-8 characters are
/// not among them.
bool is_control(char character) {
  const auto code = static_cast<unsigned char>(character);
  return (code < 0x20 && character != '\t' && line_ends.find(character) == std::string_view::npos) || code == 0x7f;
}

std::string range_text(const std::string& kind, Range range) {
  std::ostringstream text;
  text << kind;
  if (range.min == positive_range.min) {
    text << " greater than 0";
  } else if (std::isfinite(range.min) && std::isfinite(range.max)) {
    text << " from " << range.min << " to " << range.max;
  } else if (std::isfinite(range.min)) {
    text << " of at least " << range.min;
  } else if (std::isfinite(range.max)) {
    text << " of at most " << range.max;
  }
  return text.str();
}

bool in_range(double value, Range range) {
  return std::isfinite(value) && value >= range.min && value <= range.max;
}

}  // namespace

TomlTable::TomlTable(const toml::table& table, std::filesystem::path file, std::string name,
                     const std::vector<std::string_view>& known)
    : table_(&table), file_(std::move(file)), name_(std::move(name)) {
  for (const auto& [key, node] : table) {
    if (std::find(known.begin(), known.end(), key.str()) == known.end()) {
      throw error(key.str(),
                  "unknown key; the nearest known one is \"" + std::string(nearest_name(key.str(), known)) + '"');
    }
  }
}

std::string TomlTable::full_name(std::string_view key) const {
  return name_ + (name_.empty() ? "" : ".") + std::string(key);
}

std::string TomlTable::where(std::string_view key) const {
  return file_.string() + ": " + full_name(key);
}

std::string TomlTable::place(std::string_view key) const {
  const toml::node* node = find(key);
  const auto line = (node ? node->source() : table_->source()).begin.line;
  return file_.string() + (line > 0 ? ", line " + std::to_string(line) : "") + ": " + full_name(key);
}

Error TomlTable::error(std::string_view key, const std::string& message) const {
  return input_error(place(key) + ": " + message);
}

Error TomlTable::wrong(std::string_view key, const std::string& expected) const {
  const toml::node* node = find(key);
  return input_error(place(key) + " = " + (node ? value_text(*node) : "nothing") + ", expected " + expected);
}

bool TomlTable::is_auto(std::string_view key) const {
  const toml::node* node = find(key);
  return node && node->is_string() && node->as_string()->get() == "auto";
}

std::optional<std::string> TomlTable::text(std::string_view key) const {
  const std::optional<std::string> line = lines(key);
  if (line && line->find_first_of(line_ends) != std::string::npos) throw error(key, "has several lines, expected one");
  return line;
}

std::optional<std::string> TomlTable::text_among(std::string_view key, std::span<const std::string_view> known) const {
  std::optional<std::string> value = text(key);
  if (!value || std::ranges::find(known, *value) != known.end()) return value;
  std::string list;
  for (const std::string_view name : known) list += (list.empty() ? "\"" : ", \"") + std::string(name) + '"';
  throw wrong(key, "one of " + list);
}

std::optional<std::string> TomlTable::lines(std::string_view key) const {
  const toml::node* node = find(key);
  if (!node) return std::nullopt;
  if (!node->is_string() || node->as_string()->get().empty()) throw wrong(key, "a text in quotes");
  const std::string& text = node->as_string()->get();
  if (std::ranges::any_of(text, is_control)) throw error(key, "has control characters, expected a text without them");
  return text;
}

std::optional<bool> TomlTable::boolean(std::string_view key) const {
  const toml::node* node = find(key);
  if (!node) return std::nullopt;
  if (!node->is_boolean()) throw wrong(key, "true or false");
  return node->as_boolean()->get();
}

std::optional<double> TomlTable::number(std::string_view key, Range range) const {
  const toml::node* node = find(key);
  if (!node) return std::nullopt;
  const std::optional<double> value = node->is_number() ? node->value<double>() : std::nullopt;
  if (!value || !in_range(*value, range)) throw wrong(key, range_text("a number", range));
  return value;
}

std::optional<int> TomlTable::integer(std::string_view key, Range range) const {
  const toml::node* node = find(key);
  if (!node) return std::nullopt;
  range = {std::max(range.min, -2147483648.0), std::min(range.max, 2147483647.0)};
  const std::optional<std::int64_t> value = node->is_integer() ? node->value<std::int64_t>() : std::nullopt;
  if (!value || !in_range(static_cast<double>(*value), range)) throw wrong(key, range_text("a whole number", range));
  return static_cast<int>(*value);
}

std::optional<std::vector<double>> TomlTable::numbers(std::string_view key, Range range) const {
  const toml::node* node = find(key);
  if (!node) return std::nullopt;
  const auto fail = [&] { return wrong(key, range_text("a list of numbers", range)); };
  if (!node->is_array()) throw fail();
  std::vector<double> values;
  for (const toml::node& element : *node->as_array()) {
    const std::optional<double> value = element.is_number() ? element.value<double>() : std::nullopt;
    if (!value || !in_range(*value, range)) throw fail();
    values.push_back(*value);
  }
  return values;
}

std::optional<std::vector<std::string>> TomlTable::texts(std::string_view key) const {
  const toml::node* node = find(key);
  if (!node) return std::nullopt;
  if (!node->is_array()) throw wrong(key, "a list of texts");
  std::vector<std::string> values;
  for (const toml::node& element : *node->as_array()) {
    if (!element.is_string() || element.as_string()->get().empty()) throw wrong(key, "a list of texts");
    values.push_back(element.as_string()->get());
  }
  return values;
}

std::optional<TomlTable> TomlTable::section(std::string_view key, const std::vector<std::string_view>& known) const {
  const toml::node* node = find(key);
  if (!node) return std::nullopt;
  const std::string in_brackets = "[" + std::string(key) + "]";
  if (!node->is_table()) throw wrong(key, "a table, " + in_brackets);
  return TomlTable(*node->as_table(), file_, name_.empty() ? in_brackets : full_name(key), known);
}

std::vector<TomlTable> TomlTable::tables(std::string_view key, const std::vector<std::string_view>& known,
                                         const std::string& expected) const {
  std::vector<TomlTable> result;
  const toml::node* node = find(key);
  if (!node) return result;
  if (!node->is_array()) throw wrong(key, expected);
  for (const toml::node& element : *node->as_array()) {
    if (!element.is_table()) throw wrong(key, expected);
    const std::string number = " " + std::to_string(result.size() + 1);
    const std::string name = name_.empty() ? "[[" + std::string(key) + "]]" + number : full_name(key);
    result.emplace_back(*element.as_table(), file_, name, known);
  }
  return result;
}

std::filesystem::path TomlTable::resolve(std::string_view key, const std::string& path) const {
  const std::filesystem::path resolved = (file_.parent_path() / path).lexically_normal();
  std::error_code failure;
  const auto status = std::filesystem::status(resolved, failure);
  if (failure && status.type() != std::filesystem::file_type::not_found)
    throw error(key, resolved.string() + ": " + failure.message());
  return resolved;
}

std::optional<std::filesystem::path> TomlTable::existing_file(std::string_view key) const {
  const auto path = text(key);
  if (!path) return std::nullopt;
  const std::filesystem::path resolved = resolve(key, *path);
  require_file(resolved, where(key) + " =");
  return resolved;
}

}  // namespace malus
