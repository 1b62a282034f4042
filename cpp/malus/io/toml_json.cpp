#include "malus/io/toml_json.h"

#include <toml++/toml.h>

#include <sstream>

#include "malus/core/error.h"
#include "malus/io/input_file.h"

namespace malus {

std::string read_toml_as_json(const std::filesystem::path& path) {
  const std::string text = read_file(path, "options file");
  try {
    std::ostringstream json;
    json << toml::json_formatter(toml::parse(text, path.string()));
    return json.str();
  } catch (const toml::parse_error& error) {
    throw input_error(path.string() + ", line " + std::to_string(error.source().begin.line) + ": " +
                      std::string(error.description()));
  }
}

}  // namespace malus
