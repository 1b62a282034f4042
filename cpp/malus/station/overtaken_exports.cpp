#include <map>

#include "malus/io/input_file_internal.h"
#include "malus/io/workspace_internal.h"
#include "malus/station/overtaken_exports_internal.h"

namespace malus {

std::vector<std::string> overtaken_exports(const std::filesystem::path& folder) {
  using Record = Workspace::Json;
  const std::filesystem::path exports = folder / "export", record = exports / "made_from.json";
  std::error_code unreadable;
  if (!std::filesystem::is_regular_file(record, unreadable) || std::filesystem::is_empty(record, unreadable)) return {};
  std::map<std::string, Record> now;
  const Record manifest = Workspace::read_manifest(folder);
  for (const auto& step : manifest.at("steps")) {
    for (const auto& [file, output] : step.at("outputs").items()) now[file] = output.at("sha256");
  }
  // A record that is no longer valid JSON gives no warnings.
  const Record noted = Record::parse(read_file(record, "record"), nullptr, false);
  std::vector<std::string> told;
  for (const auto& [name, made_from] : noted.items()) {
    if (!made_from.is_object() || !std::filesystem::exists(exports / name, unreadable)) continue;
    bool overtaken = false;
    for (const auto& [file, sha256] : made_from.items()) overtaken = overtaken || now[file] != sha256;
    if (overtaken) {
      told.push_back((exports / name).string() +
                     " is of an earlier result of this workspace; export it again, or remove it");
    }
  }
  return told;
}

}  // namespace malus
