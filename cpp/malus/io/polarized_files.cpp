#include <re2/re2.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <span>

#include "malus/core/error.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/input_file_internal.h"
#include "malus/io/polarized_files_internal.h"

namespace malus {
namespace {

constexpr std::size_t most_names_shown = 6;

bool is_digit(char c) {
  return c >= '0' && c <= '9';
}

/// The run of digits at the front, without leading zeros; removed from `text`.
std::string_view take_digits(std::string_view& text) {
  const std::size_t length =
      static_cast<std::size_t>(std::find_if_not(text.begin(), text.end(), is_digit) - text.begin());
  std::string_view digits = text.substr(0, length);
  text.remove_prefix(length);
  digits.remove_prefix(std::min(digits.find_first_not_of('0'), digits.size()));
  return digits;
}

bool has_suffix(const std::filesystem::path& path, std::span<const std::string_view> suffixes) {
  const std::string suffix = in_lower_case(path.extension().string());
  const bool hidden = path.filename().string().starts_with('.');
  return !hidden && std::ranges::find(suffixes, suffix) != suffixes.end();
}

bool is_image_name(const std::filesystem::path& path) {
  return has_suffix(path, image_suffixes) || is_raw_name(path);
}

/// Names are matched as bytes, in any encoding. RE2 bounds time and memory of a search; std::regex bounds neither.
re2::RE2::Options by_bytes(bool any_case) {
  re2::RE2::Options options(re2::RE2::Latin1);
  options.set_case_sensitive(!any_case);
  options.set_log_errors(false);
  return options;
}

/// Where a file's name may hold an angle: behind a word such as "pol", before one, or, if the folder's name has such a
/// word, at the end of the name.
enum class AnglePlace { behind_word, before_word, last_in_folder };

/// A number in a file's name. A dash before it separates it from a word ("pol-45"), or is its sign ("pol_-45").
struct NumberInName {
  double value;
  std::size_t dashes;  ///< directly before the number
};

std::optional<NumberInName> number_at(AnglePlace place, const std::filesystem::path& file) {
  static const std::string number = R"((-*)(\d+(?:\.\d+)?))";
  static const re2::RE2 behind_word(
      "(?:^|[^a-z])(?:pol|polari[sz]er|polari[sz]ation|angle|ang|deg|rot)[ _.=-]*?" + number, by_bytes(true));
  static const re2::RE2 before_word(number + "[ _-]*(?:deg|°)", by_bytes(true));
  static const re2::RE2 last_number(number + R"(\D*$)", by_bytes(true));
  static const re2::RE2 folder_word("(?:^|[^a-z])(?:pol|polari[sz]e[rd]|polari[sz]ation|angles?)", by_bytes(true));
  const std::string name = file.stem().string(), folder = file.parent_path().filename().string();
  if (place == AnglePlace::last_in_folder && !re2::RE2::PartialMatch(folder, folder_word)) return std::nullopt;
  const re2::RE2& marked = place == AnglePlace::behind_word   ? behind_word
                           : place == AnglePlace::before_word ? before_word
                                                              : last_number;
  std::optional<NumberInName> last;
  std::array<re2::StringPiece, 3> found;
  for (std::size_t begin = 0; marked.Match(name, begin, name.size(), re2::RE2::UNANCHORED, found.data(), 3);) {
    const auto value = number_of<double>({found[2].data(), found[2].size()});
    last = value ? std::optional(NumberInName{*value, found[1].size()}) : std::nullopt;
    begin = static_cast<std::size_t>(found[0].end() - name.data());
  }
  return last;
}

/// The numbers at this place, one for each file; fewer if names have none there. Dashes that all names have are
/// separators; one that only some have is the sign of a negative angle.
std::vector<double> angles_at(AnglePlace place, const std::vector<std::filesystem::path>& files) {
  std::vector<NumberInName> numbers;
  for (const auto& file : files) {
    if (const auto number = number_at(place, file)) numbers.push_back(*number);
  }
  if (numbers.empty()) return {};
  const std::size_t separators = std::ranges::min(numbers, {}, &NumberInName::dashes).dashes;
  std::vector<double> angles;
  for (const auto& [value, dashes] : numbers) angles.push_back(dashes > separators ? -value : value);
  return angles;
}

/// Throws an input error if two files have the same name but for the suffix, such as a TIFF and its JPEG preview: they
/// would count as two exposures, and their brightness follows different curves.
void require_one_file_an_image(const std::vector<std::filesystem::path>& files, const std::string& where) {
  std::map<std::filesystem::path, std::filesystem::path> of_name;
  for (const auto& file : files) {
    const auto [other, added] = of_name.emplace(file.parent_path() / file.stem(), file.filename());
    if (added) continue;
    throw input_error(where + ": " + other->second.string() + " and " + file.filename().string() +
                      " have the same name, expected one file of each image; a pattern such as \"*" +
                      file.extension().string() + "\" chooses one kind");
  }
}

/// Whether these can be the positions of a polarizer: round angles of at most 360°, 0 or 180° among them, three or more
/// modulo 180°, and either a wide step between neighbors or evenly spread over the half turn. Consecutive file numbers
/// are no such series.
bool is_polarizer_series(std::span<const double> angles) {
  const auto is_multiple = [](double angle, double step) {
    return std::abs(angle - step * std::round(angle / step)) < 1e-9;
  };
  std::set<double> places;
  for (const double angle : angles) {
    if (std::abs(angle) > 360 || !(is_multiple(angle, 5) || is_multiple(angle, 22.5))) return false;
    places.insert(angle - 180 * std::floor(angle / 180));
  }
  if (places.size() < 3 || !places.contains(0)) return false;
  constexpr double wide_step = 15;
  double smallest = 180, largest = 0;
  for (auto place = places.begin(); place != places.end(); ++place) {
    const auto next = std::next(place);
    const double step = (next == places.end() ? 180 : *next) - *place;
    smallest = std::min(smallest, step);
    largest = std::max(largest, step);
  }
  return smallest >= wide_step || largest - smallest < 1e-9;
}

}  // namespace

bool is_raw_name(const std::filesystem::path& path) {
  return has_suffix(path, raw_suffixes);
}

bool natural_less(std::string_view a, std::string_view b) {
  const std::string_view whole_a = a, whole_b = b;
  while (!a.empty() && !b.empty()) {
    if (is_digit(a.front()) && is_digit(b.front())) {
      const std::string_view x = take_digits(a), y = take_digits(b);
      if (x.size() != y.size()) return x.size() < y.size();
      if (x != y) return x < y;
    } else {
      if (a.front() != b.front()) return a.front() < b.front();
      a.remove_prefix(1);
      b.remove_prefix(1);
    }
  }
  if (a.empty() != b.empty()) return a.empty();
  return whole_a < whole_b;
}

std::vector<std::filesystem::path> list_images(const std::filesystem::path& base, const std::string& folder_or_glob,
                                               const std::string& where) {
  std::vector<std::filesystem::path> files;
  const std::filesystem::path folder = (base / folder_or_glob).lexically_normal();
  std::error_code failure, not_looked_at;
  if (std::filesystem::is_directory(folder, not_looked_at)) {
    for (std::filesystem::directory_iterator entry(folder, failure), end; !failure && entry != end;
         entry.increment(failure)) {
      if (is_image_name(entry->path()) && entry->is_regular_file(not_looked_at)) files.push_back(entry->path());
    }
    if (failure) throw input_error(where + " = " + folder.string() + ": " + failure.message());
    // Cameras write RAW and JPEG side by side: the RAW files are the linear ones.
    if (std::ranges::any_of(files, is_raw_name))
      std::erase_if(files, [](const auto& file) { return !is_raw_name(file); });
  } else {
    files = match_files(base, folder_or_glob, where);
  }
  std::sort(files.begin(), files.end(),
            [](const auto& a, const auto& b) { return natural_less(a.string(), b.string()); });
  require_one_file_an_image(files, where);
  return files;
}

double angle_of_name(const std::filesystem::path& file, const std::string& pattern, const std::string& where) {
  constexpr std::size_t longest_shown = 200;
  std::string shown = where;
  shown.append(" = \"").append(pattern, 0, longest_shown).append(pattern.size() > longest_shown ? "…\"" : "\"");
  constexpr std::size_t longest_pattern = 1000;
  if (pattern.size() > longest_pattern) {
    throw input_error(shown + " has " + std::to_string(pattern.size()) + " bytes, expected at most " +
                      std::to_string(longest_pattern));
  }
  const re2::RE2 expression(pattern, by_bytes(false));
  if (!expression.ok()) {
    throw input_error(shown + " is not a regular expression of RE2's kind (" +
                      expression.error().substr(0, longest_shown) + ")");
  }
  if (expression.NumberOfCapturingGroups() != 1) {
    throw input_error(shown + ", expected a regular expression with one group that captures the angle");
  }
  std::string digits;
  re2::RE2::PartialMatch(file.filename().string(), expression, &digits);
  const std::optional<double> angle = number_of<double>(digits);
  if (!angle) {
    throw input_error(shown + " finds no angle in the name of " + file.string());
  }
  return *angle;
}

std::vector<double> angles_of_names(const std::vector<std::filesystem::path>& files, const std::string& where,
                                    const std::string& instead) {
  for (const AnglePlace place : {AnglePlace::behind_word, AnglePlace::before_word, AnglePlace::last_in_folder}) {
    const std::vector<double> angles = angles_at(place, files);
    if (angles.size() == files.size() && is_polarizer_series(angles)) return angles;
  }
  std::string list;
  for (std::size_t i = 0; i < std::min(files.size(), most_names_shown); ++i) {
    list += (i > 0 ? ", " : "") + files[i].filename().string();
  }
  if (files.size() > most_names_shown) list += ", … (" + std::to_string(files.size()) + " files)";
  throw input_error(where + ": the names do not say the polarizer's angles beyond doubt: " + list +
                    "; numbers count as angles only beside a word such as pol, angle or deg (or in a folder of such a "
                    "name), and if they are a polarizer's series such as 0, 45, 90, 135; " +
                    instead);
}

}  // namespace malus
