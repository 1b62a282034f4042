#include <glob.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <regex>
#include <span>

#include "malus/core/error.h"
#include "malus/io/image_file.h"
#include "malus/io/polarized_files_internal.h"

namespace malus {
namespace {

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

bool has_extension(const std::filesystem::path& path, std::span<const std::string_view> extensions) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  const bool hidden = path.filename().string().starts_with('.');
  return !hidden && std::find(extensions.begin(), extensions.end(), extension) != extensions.end();
}

bool is_image_name(const std::filesystem::path& path) {
  constexpr std::array<std::string_view, 5> extensions = {".png", ".tif", ".tiff", ".jpg", ".jpeg"};
  return has_extension(path, extensions) || is_raw_name(path);
}

/// The text as a glob that matches only itself.
std::string without_wildcards(const std::string& text) {
  std::string pattern;
  for (const char c : text) {
    if (c == '*' || c == '?' || c == '[' || c == '\\') pattern += '\\';
    pattern += c;
  }
  return pattern;
}

std::vector<std::filesystem::path> match(const std::string& pattern) {
  std::vector<std::filesystem::path> files;
  glob_t matches{};
  if (::glob(pattern.c_str(), 0, nullptr, &matches) == 0) {
    for (std::size_t i = 0; i < matches.gl_pathc; ++i) files.emplace_back(matches.gl_pathv[i]);
  }
  ::globfree(&matches);
  return files;
}

}  // namespace

bool is_raw_name(const std::filesystem::path& path) {
  constexpr std::array<std::string_view, 15> extensions = {".3fr", ".arw", ".cr2", ".cr3", ".crw",
                                                           ".dng", ".iiq", ".nef", ".nrw", ".orf",
                                                           ".pef", ".raf", ".rw2", ".sr2", ".srw"};
  return has_extension(path, extensions);
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

std::vector<std::filesystem::path> list_images(const std::filesystem::path& base, const std::string& folder_or_glob) {
  std::vector<std::filesystem::path> files;
  const std::filesystem::path folder = (base / folder_or_glob).lexically_normal();
  if (std::filesystem::is_directory(folder)) {
    for (const auto& entry : std::filesystem::directory_iterator(folder)) {
      if (entry.is_regular_file() && is_image_name(entry.path())) files.push_back(entry.path());
    }
    // Cameras write RAW and JPEG side by side: the RAW files are the linear ones.
    if (std::ranges::any_of(files, is_raw_name))
      std::erase_if(files, [](const auto& file) { return !is_raw_name(file); });
  } else if (std::filesystem::path(folder_or_glob).is_absolute()) {
    files = match(folder_or_glob);
  } else {
    files = match(without_wildcards(base.string()) + "/" + folder_or_glob);
  }
  std::sort(files.begin(), files.end(),
            [](const auto& a, const auto& b) { return natural_less(a.string(), b.string()); });
  return files;
}

double angle_of_name(const std::filesystem::path& file, const std::string& pattern, const std::string& where) {
  static const std::string last_number = R"((\d+(?:\.\d+)?)\D*$)";
  const std::string name = pattern.empty() ? file.stem().string() : file.filename().string();
  std::smatch match;
  try {
    const std::regex expression(pattern.empty() ? last_number : pattern);
    if (expression.mark_count() != 1) {
      throw input_error(where + " = \"" + pattern +
                        "\", expected a regular expression with one group that captures the angle");
    }
    std::regex_search(name, match, expression);
  } catch (const std::regex_error& error) {
    throw input_error(where + " = \"" + pattern + "\" is not a regular expression (" + error.what() + ")");
  }
  const std::string number = match.empty() ? std::string() : match[1].str();
  double angle = 0;
  const auto [end, error] = std::from_chars(number.data(), number.data() + number.size(), angle);
  if (number.empty() || error != std::errc() || end != number.data() + number.size()) {
    throw input_error(where + ": no angle in the name of " + file.string() +
                      (pattern.empty() ? ", expected a number in it" : " by the pattern \"" + pattern + "\""));
  }
  return angle;
}

}  // namespace malus
