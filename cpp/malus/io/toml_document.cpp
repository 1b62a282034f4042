#include <algorithm>
#include <cstddef>
#include <sstream>
#include <string_view>
#include <vector>

#include "malus/core/error.h"
#include "malus/io/input_file_internal.h"
#include "malus/io/toml_document_internal.h"
#include "malus/io/toml_json_internal.h"

namespace malus {
namespace {

/// Place after the text in quotes that begins at `begin`; of one without an end, a place after its line or the file.
std::size_t after_quotes(std::string_view text, std::size_t begin) {
  const char quote = text[begin];
  const std::string fence(3, quote);
  const bool has_lines = text.substr(begin, 3) == fence;
  std::size_t end = begin + (has_lines ? 3 : 1);
  const auto ends = [&] { return has_lines ? text.substr(end, 3) == fence : text[end] == quote || text[end] == '\n'; };
  while (end < text.size() && !ends()) end += quote == '"' && text[end] == '\\' ? 2 : 1;
  end += has_lines ? 3 : 1;
  // Two more quotes before the closing ones belong to a text of several lines.
  for (int more = 0; has_lines && more < 2 && end < text.size() && text[end] == quote; ++more) ++end;
  return std::min(end, text.size());
}

/// Counts the parts of dotted keys, with those of the keys of the inline tables around them: each part is a table in a
/// table. Numbers and dates, whose dots are counted alike, have few.
class KeyParts {
 public:
  /// Takes the next character outside of quotes and comments; returns the parts so far.
  int count(char next) {
    if (next == '.') return ++parts_;
    if (next == '=') {
      of_value_ = parts_;
      parts_ = around_ + 1;
    } else if (next == '{' || next == '[') {
      open_.push_back(around_);
      begin(of_value_);
    } else if (next == '}' || next == ']') {
      begin(open_.empty() ? 0 : open_.back());
      if (!open_.empty()) open_.pop_back();
    } else if (next == ',' || next == '\n') {
      begin(around_);
    }
    return parts_;
  }

 private:
  void begin(int around) {
    around_ = of_value_ = around;
    parts_ = around + 1;
  }

  std::vector<int> open_;  ///< parts around each table and list that is open
  int around_ = 0;         ///< parts of the keys of the tables around this place
  int of_value_ = 0;       ///< parts around the value that is read
  int parts_ = 1;          ///< parts up to this place
};

void require_short_keys(std::string_view text, const std::filesystem::path& path) {
  constexpr int most_parts = 100;
  KeyParts parts;
  for (std::size_t place = 0; place < text.size();) {
    if (text[place] == '"' || text[place] == '\'') {
      place = after_quotes(text, place);
    } else if (text[place] == '#') {
      place = std::min(text.find('\n', place), text.size());
    } else if (parts.count(text[place++]) > most_parts) {
      const auto line = 1 + std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(place), '\n');
      throw input_error(path.string() + ", line " + std::to_string(line) + ": not TOML (a key of more than " +
                        std::to_string(most_parts) + " parts)");
    }
  }
}

/// A frequent cause of invalid TOML that editors and other systems bring into a file; "" = none found.
std::string likely_cause(const std::string& text, const toml::parse_error& error) {
  if (error.description().find("utf-8") != std::string_view::npos)
    return "; the file is not UTF-8 text, expected it saved as UTF-8";
  std::size_t begin = 0;
  for (toml::source_index line = 1; line < error.source().begin.line && begin < text.size(); ++line)
    begin = std::min(text.find('\n', begin), text.size() - 1) + 1;
  const std::size_t end = std::min(text.find('\n', begin), text.size());
  return path_of_windows(std::string_view(text).substr(begin, end - begin));
}

}  // namespace

toml::table read_toml(const std::filesystem::path& path, const std::string& what) {
  const std::string text = read_file(path, what);
  require_short_keys(text, path);
  try {
    return toml::parse(text, path.string());
  } catch (const toml::parse_error& error) {
    throw input_error(path.string() + ", line " + std::to_string(error.source().begin.line) + ": not TOML (" +
                      std::string(error.description()) + ")" + likely_cause(text, error));
  }
}

std::string read_toml_as_json(const std::filesystem::path& path, const std::string& what) {
  std::ostringstream json;
  json << toml::json_formatter(read_toml(path, what));
  return json.str();
}

}  // namespace malus
