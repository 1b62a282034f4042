#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>

#include "malus/core/error.h"

namespace malus {

/// A file that appears under its name only when it is complete: bytes go to a temporary name in the same folder;
/// `commit` flushes them to the disk and renames. Without `commit` the temporary file is removed.
///
/// Every failure throws and names the path and the system's reason: ErrorCode::resource when the machine lacks a
/// resource (no space, quota, memory, an I/O fault), ErrorCode::input when the path is wrong (folder absent, not
/// writable).
class AtomicFile {
 public:
  explicit AtomicFile(std::filesystem::path path);
  ~AtomicFile();
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;

  /// Writes behind what this function has written before.
  void write(const void* data, std::size_t size);
  void write(std::string_view bytes) { write(bytes.data(), bytes.size()); }
  /// Lets the system reserve room for a file of `size` bytes, so that a full disk is noticed before the work.
  void expect(std::size_t size);
  /// Writes at `offset`, which may lie beyond the file's end; several threads may write at once.
  void write_at(std::size_t offset, const void* data, std::size_t size);
  void commit();

  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_, temporary_;
  int descriptor_ = -1;
  std::size_t end_ = 0;  ///< of what write() has written
};

/// Writes a whole file atomically.
void write_file(const std::filesystem::path& path, std::string_view bytes);

/// Whether this is the temporary name of a file that an AtomicFile, or its counterpart in Python, has begun.
bool is_unfinished(const std::filesystem::path& path);

/// Creates a folder and its parents; an existing one is fine. Throws ErrorCode::input when the folder cannot be created
/// (a file is in the way, no permission) or is not writable, ErrorCode::resource when the disk is full.
void create_folder(const std::filesystem::path& folder);

/// Error for a failed system call on a file, from errno; the ErrorCode is as for AtomicFile. `action`: "cannot write".
Error file_error(const std::string& action, const std::filesystem::path& path, int error_number);

}  // namespace malus
