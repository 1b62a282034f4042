#include <sstream>

#include "malus/io/toml_document_internal.h"
#include "malus/io/toml_json_internal.h"

namespace malus {

std::string read_toml_as_json(const std::filesystem::path& path, const std::string& what) {
  std::ostringstream json;
  json << toml::json_formatter(read_toml(path, what));
  return json.str();
}

}  // namespace malus
