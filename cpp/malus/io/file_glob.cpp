#include <fnmatch.h>

#include "malus/core/error.h"
#include "malus/io/polarized_files_internal.h"

namespace malus {
namespace {

namespace fs = std::filesystem;

/// A pattern with more names is not for one station's images; it would search the whole disk.
constexpr int most_names = 100'000;

bool has_wildcards(const std::string& part) {
  return part.find_first_of("*?[\\") != std::string::npos;
}

class Search {
 public:
  Search(const fs::path& pattern, const std::string& where) : where_(where) {
    for (const fs::path& part : pattern.relative_path()) parts_.push_back(part.string());
  }

  std::vector<fs::path> below(const fs::path& base) {
    match(base, 0);
    return std::move(found_);
  }

 private:
  void match(const fs::path& folder, std::size_t index) {
    if (index == parts_.size()) {
      found_.push_back(folder);
      return;
    }
    const std::string& part = parts_[index];
    std::error_code error;
    if (!has_wildcards(part)) {
      count();
      const fs::path next = folder / part;
      if (fs::exists(next, error)) match(next, index + 1);
      return;
    }
    for (fs::directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error)) {
      count();
      if (::fnmatch(part.c_str(), entry->path().filename().c_str(), FNM_PERIOD) != 0) continue;
      std::error_code no_folder;
      if (index + 1 == parts_.size() || entry->is_directory(no_folder)) match(entry->path(), index + 1);
    }
  }

  void count() {
    if (++looked_at_ > most_names) {
      throw input_error(where_ + ": more than " + std::to_string(most_names) +
                        " names to look at, expected a pattern for the images of one station");
    }
  }

  std::string where_;
  std::vector<std::string> parts_;
  std::vector<fs::path> found_;
  int looked_at_ = 0;
};

}  // namespace

std::vector<fs::path> match_files(const fs::path& base, const std::string& pattern, const std::string& where) {
  const fs::path path(pattern);
  return Search(path, where).below(path.is_absolute() ? path.root_path() : base);
}

}  // namespace malus
