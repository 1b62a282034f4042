#pragma once

#include <charconv>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <initializer_list>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>
#include <vector>

#include "malus/core/error.h"
#include "malus/core/large_allocator.h"

namespace malus {

/// Throws ErrorCode::input unless the whole path is UTF-8, as all code that records or shows paths expects. `what`
/// states what the file or folder is for.
void require_utf8(const std::filesystem::path& path, const std::string& what);

/// Size in bytes of a file a user named. Throws ErrorCode::input unless it is a regular, readable, non-empty file.
/// `what` says what the file is for ("polarized image"); the message names it, the path and the reason.
std::uint64_t require_file(const std::filesystem::path& path, const std::string& what);

/// The number that the whole text is; nothing if it is anything else, or out of the type's range.
template <class T>
std::optional<T> number_of(std::string_view text) {
  T value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  const bool is_number = error == std::errc() && end == text.data() + text.size();
  return is_number ? std::optional(value) : std::nullopt;
}

/// Sets `value` to the number that the whole word is, in C's notation; infinity if it is beyond the type's range. False
/// if it is anything else.
inline bool parse_number(std::string_view word, double& value) {
  if (!word.empty() && word.front() == '+') word.remove_prefix(1);
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error == std::errc::result_out_of_range) value = std::numeric_limits<double>::infinity();
  return error != std::errc::invalid_argument && end == word.data() + word.size();
}

/// Replaces `words` by those of a line.
void split_words(std::string_view line, std::vector<std::string_view>& words, std::string_view separators = " \t,;");

/// The text with its capital letters replaced by small ones.
std::string in_lower_case(std::string text);

/// Whether a line is blank, or begins, after blanks, with one of the marks.
bool is_comment(std::string_view line, std::initializer_list<std::string_view> marks);

/// Advice, for messages, on what to write instead of the backslashes in a path or in a line of a file; "" = no
/// backslashes.
std::string path_of_windows(std::string_view text);

/// The whole file; errors as require_file, and ErrorCode::resource when reading fails.
std::string read_file(const std::filesystem::path& path, const std::string& what);

/// As read_file, for files that may be large.
LargeVector<char> read_bytes(const std::filesystem::path& path, const std::string& what);

/// Reads a file front to back through one buffer, so that memory does not grow with the file.
class InputFile {
 public:
  InputFile(const std::filesystem::path& path, const std::string& what);
  ~InputFile();
  InputFile(const InputFile&) = delete;
  InputFile& operator=(const InputFile&) = delete;

  std::uint64_t size() const { return size_; }
  /// Number of bytes not read yet. Sizes claimed by a header are compared with this before memory is allocated for
  /// them.
  std::uint64_t remaining() const { return position_ < size_ ? size_ - position_ : 0; }

  /// The next bytes in memory, which are still to be read; empty only at the end. Valid until the next call.
  std::string_view buffered();
  /// Copies exactly `size` bytes; throws an input error ("… is truncated") when the file ends before.
  void read(void* target, std::size_t size);
  /// Skips exactly `size` bytes; errors as in read().
  void skip(std::uint64_t size);
  /// Next line without its line break ("\n" or "\r\n"); false at the end. The view is valid until the next call.
  bool read_line(std::string_view& line);
  /// Number of the line that was read last, from 1.
  std::uint64_t line_number() const { return line_number_; }

  /// Input error "<what> <path>: <message>".
  Error error(const std::string& message) const;

 private:
  /// Reads the next bytes, at least one and at most `size`; throws at the end of the file.
  std::string_view take(std::uint64_t size);

  std::filesystem::path path_;
  std::string what_;
  std::uint64_t size_ = 0, position_ = 0, line_number_ = 0;
  int descriptor_ = -1;
  std::vector<char> buffer_;
  std::size_t begin_ = 0, end_ = 0;
  std::string line_;
};

/// Records or lines of a large file that are read between two looks whether the run is canceled.
inline constexpr std::uint64_t records_between_checks = 1 << 16;

/// Input error on the line of a file that was read last.
Error malformed_line(const InputFile& file, std::string_view line, const std::string& expected = "numbers");

}  // namespace malus
