#include <nlohmann/json.hpp>

#include "malus/core/error.h"
#include "malus/io/utf8_name_internal.h"

namespace malus {

void require_utf8(const std::filesystem::path& path, const std::string& what) {
  using Json = nlohmann::json;
  const Json name = std::filesystem::absolute(path).string();
  const std::string shown = name.dump(-1, ' ', false, Json::error_handler_t::ignore);
  // Invalid bytes are left out of `shown`, so it then differs from the name.
  if (Json::parse(shown) == name) return;
  throw input_error(what + " " + name.dump(-1, ' ', false, Json::error_handler_t::replace) +
                    ": the name is not UTF-8; rename the file or folder (convmv does many at once)");
}

}  // namespace malus
