#include <algorithm>
#include <cctype>
#include <sstream>
#include <string_view>

#include "malus/core/error.h"
#include "malus/io/input_file_internal.h"
#include "malus/io/toml_document_internal.h"
#include "malus/io/toml_json_internal.h"

namespace malus {
namespace {

/// Parts of the longest dotted key in a line. A key ends at an equals sign, or at the bracket of a header; dots in a
/// text or list are no key.
int key_parts(std::string_view line) {
  int most = 0, parts = 1;
  for (const char c : line) {
    if (c == '=' || c == ']') most = std::max(most, parts);
    const bool is_in_key = std::isalnum(static_cast<unsigned char>(c)) != 0 ||
                           std::string_view("._-\"' \t").find(c) != std::string_view::npos;
    parts = is_in_key ? parts + (c == '.') : 1;
  }
  return most;
}

void require_short_keys(const std::string& text, const std::filesystem::path& path) {
  constexpr int most_parts = 100;
  std::size_t begin = 0;
  for (int line = 1; begin < text.size(); ++line) {
    const std::size_t end = std::min(text.find('\n', begin), text.size());
    if (key_parts(std::string_view(text).substr(begin, end - begin)) > most_parts) {
      throw input_error(path.string() + ", line " + std::to_string(line) + ": not TOML (a key of more than " +
                        std::to_string(most_parts) + " parts)");
    }
    begin = end + 1;
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
