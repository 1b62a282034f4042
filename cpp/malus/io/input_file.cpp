#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <nlohmann/json.hpp>
#include <system_error>

#include "malus/io/input_file_internal.h"

namespace malus {
namespace {

constexpr std::size_t buffer_size = 1 << 20;
constexpr std::size_t longest_line = 1 << 26;

}  // namespace

void split_words(std::string_view line, std::vector<std::string_view>& words, std::string_view separators) {
  words.clear();
  for (std::size_t at = 0; (at = line.find_first_not_of(separators, at)) != std::string_view::npos;) {
    const std::size_t end = std::min(line.find_first_of(separators, at), line.size());
    words.push_back(line.substr(at, end - at));
    at = end;
  }
}

std::string in_lower_case(std::string text) {
  std::ranges::transform(text, text.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

bool is_comment(std::string_view line, std::initializer_list<std::string_view> marks) {
  line.remove_prefix(std::min(line.find_first_not_of(" \t"), line.size()));
  return line.empty() || std::ranges::any_of(marks, [line](std::string_view mark) { return line.starts_with(mark); });
}

std::string path_of_windows(std::string_view text) {
  return text.find('\\') == std::string_view::npos
             ? ""
             : "; folders are separated by /, as in scans/cloud.ply; drive C: of Windows is /mnt/c in WSL";
}

void require_utf8(const std::filesystem::path& path, const std::string& what) {
  using Json = nlohmann::json;
  const Json name = std::filesystem::absolute(path).string();
  const std::string shown = name.dump(-1, ' ', false, Json::error_handler_t::ignore);
  // Invalid bytes are left out of `shown`, so it then differs from the name.
  if (Json::parse(shown) == name) return;
  throw input_error(what + " " + name.dump(-1, ' ', false, Json::error_handler_t::replace) +
                    ": the name is not UTF-8; rename the file or folder (convmv does many at once)");
}

std::uint64_t require_file(const std::filesystem::path& path, const std::string& what) {
  require_utf8(path, what);
  const std::string name = what + " " + path.string();
  std::error_code error;
  const auto status = std::filesystem::status(path, error);
  if (status.type() == std::filesystem::file_type::not_found)
    throw input_error(name + ": no such file" + path_of_windows(path.string()));
  if (error) throw input_error(name + ": " + error.message());
  if (std::filesystem::is_directory(status)) throw input_error(name + " is a folder, expected a file");
  if (!std::filesystem::is_regular_file(status)) throw input_error(name + " is not a regular file");
  if (::access(path.c_str(), R_OK) != 0) throw input_error(name + ": " + std::generic_category().message(errno));
  const std::uint64_t size = std::filesystem::file_size(path, error);
  if (error) throw input_error(name + ": " + error.message());
  if (size == 0) throw input_error(name + " is empty");
  return size;
}

InputFile::InputFile(const std::filesystem::path& path, const std::string& what)
    : path_(path), what_(what), size_(require_file(path, what)), buffer_(std::min<std::uint64_t>(buffer_size, size_)) {
  descriptor_ = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor_ < 0) throw error(std::generic_category().message(errno));
}

InputFile::~InputFile() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

Error InputFile::error(const std::string& message) const {
  return input_error(what_ + " " + path_.string() + ": " + message);
}

std::string_view InputFile::buffered() {
  while (begin_ == end_) {
    const ssize_t got = ::read(descriptor_, buffer_.data(), buffer_.size());
    if (got == 0) return {};
    if (got > 0) {
      begin_ = 0;
      end_ = static_cast<std::size_t>(got);
    } else if (errno != EINTR) {
      throw resource_error("cannot read " + what_ + " " + path_.string() + ": " +
                           std::generic_category().message(errno));
    }
  }
  return {buffer_.data() + begin_, end_ - begin_};
}

std::string_view InputFile::take(std::uint64_t size) {
  const std::string_view part = buffered().substr(0, size);
  if (part.empty()) throw error("is truncated (ends after " + std::to_string(size_) + " bytes)");
  begin_ += part.size();
  position_ += part.size();
  return part;
}

void InputFile::skip(std::uint64_t size) {
  while (size > 0) size -= take(size).size();
}

void InputFile::read(void* target, std::size_t size) {
  char* out = static_cast<char*>(target);
  while (size > 0) {
    const std::string_view part = take(size);
    std::memcpy(out, part.data(), part.size());
    out += part.size();
    size -= part.size();
  }
}

bool InputFile::read_line(std::string_view& line) {
  line_.clear();
  if (buffered().empty()) return false;
  for (bool ended = false; !ended && !buffered().empty();) {
    const std::string_view rest = buffered();
    const std::size_t length = std::min(rest.find('\n'), rest.size());
    line_.append(rest.substr(0, length));
    ended = length < rest.size();
    if (!ended && line_.size() > longest_line) throw error("has a line of more than 64 MB; is it a text file?");
    take(length + (ended ? 1 : 0));
  }
  ++line_number_;
  if (!line_.empty() && line_.back() == '\r') line_.pop_back();
  line = line_;
  return true;
}

std::string read_file(const std::filesystem::path& path, const std::string& what) {
  InputFile file(path, what);
  std::string bytes(file.size(), '\0');
  file.read(bytes.data(), bytes.size());
  return bytes;
}

LargeVector<char> read_bytes(const std::filesystem::path& path, const std::string& what) {
  InputFile file(path, what);
  LargeVector<char> bytes(file.size());
  file.read(bytes.data(), bytes.size());
  return bytes;
}

Error malformed_line(const InputFile& file, std::string_view line, const std::string& expected) {
  return file.error("line " + std::to_string(file.line_number()) + " = \"" + std::string(line.substr(0, 60)) +
                    "\", expected " + expected);
}

}  // namespace malus
