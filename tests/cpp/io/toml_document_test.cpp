#include <string_view>

#include "malus/io/toml_json_internal.h"
#include "temporary_folder.h"
#include "thrown_error.h"

namespace malus {
namespace {

// With toml++ as headers only and with assertions, its parser ended the program on each of these.
TEST(TomlDocument, MalformedFilesAreErrorsInBuildsWithAssertionsToo) {
  const TemporaryFolder folder;
  for (const std::string_view text : {"a = [[}", "a = 1979-05-27 8\nb = 1", "[\r", "a = [1979-05-27true07:32:00"}) {
    const std::filesystem::path path = folder.write("options.toml", text);
    expect_error(
        ErrorCode::input, [&] { read_toml_as_json(path, "options file"); }, path.string() + ", line 1: not TOML (");
  }
}

}  // namespace
}  // namespace malus
