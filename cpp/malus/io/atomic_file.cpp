#include "malus/io/atomic_file.h"

#include <fcntl.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdint>
#include <system_error>
#include <utility>

namespace malus {
namespace {

std::filesystem::path temporary_name(const std::filesystem::path& path) {
  static std::atomic<unsigned> counter{0};
  std::filesystem::path name(".");
  name += path.filename();
  name += ".partial-" + std::to_string(::getpid()) + "-" + std::to_string(counter.fetch_add(1));
  return path.parent_path() / name;
}

/// A file as large pushes others out of the system's cache, which copies it on one thread at a time; in a virtual
/// machine fresh pages of the cache may cost more than what is written to them.
constexpr std::size_t large_file = std::size_t{64} << 20;

void write_whole(int descriptor, std::size_t offset, const char* bytes, std::size_t size,
                 const std::filesystem::path& path) {
  while (size > 0) {
    const ssize_t written = ::pwrite(descriptor, bytes, size, static_cast<off_t>(offset));
    if (written < 0) {
      if (errno == EINTR) continue;
      throw file_error("cannot write", path, errno);
    }
    bytes += written;
    offset += static_cast<std::size_t>(written);
    size -= static_cast<std::size_t>(written);
  }
}

/// Makes the rename itself durable. Not every file system can sync a folder, so failure is not an error.
void sync_folder(const std::filesystem::path& folder) {
  const int descriptor = ::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor < 0) return;
  ::fsync(descriptor);
  ::close(descriptor);
}

}  // namespace

Error file_error(const std::string& action, const std::filesystem::path& path, int error_number) {
  const std::string message = action + " " + path.string() + ": " + std::generic_category().message(error_number);
  switch (error_number) {
    case ENOSPC:
    case EDQUOT:
    case EFBIG:
    case EIO:
    case ENOMEM:
    case EMFILE:
    case ENFILE:
      return resource_error(message);
    default:
      return input_error(message);
  }
}

AtomicFile::AtomicFile(std::filesystem::path path) : path_(std::move(path)), temporary_(temporary_name(path_)) {
  if (std::filesystem::is_directory(path_)) throw file_error("cannot write", path_, EISDIR);
  descriptor_ = ::open(temporary_.c_str(), O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  if (descriptor_ < 0) throw file_error("cannot write", path_, errno);
}

AtomicFile::~AtomicFile() {
  if (direct_ >= 0) ::close(direct_);
  if (descriptor_ >= 0) ::close(descriptor_);
  if (!temporary_.empty()) ::unlink(temporary_.c_str());
}

void AtomicFile::write(const void* data, std::size_t size) {
  const char* bytes = static_cast<const char*>(data);
  while (size > 0) {
    const ssize_t written = ::write(descriptor_, bytes, size);
    if (written < 0) {
      if (errno == EINTR) continue;
      throw file_error("cannot write", path_, errno);
    }
    bytes += written;
    size -= static_cast<std::size_t>(written);
  }
}

/// Returns how many of the bytes, which begin at a page, were written: whole pages, none if the system cannot do it.
std::size_t AtomicFile::write_directly(std::size_t offset, const char* data, std::size_t size) {
  std::size_t done = 0;
  for (size -= size % page_size; done < size;) {
    const ssize_t written = ::pwrite(direct_, data + done, size - done, static_cast<off_t>(offset + done));
    if (written < 0 && errno == EINTR) continue;
    if (written < 0 && errno == EINVAL) break;  // other alignments than ours are wanted
    if (written < 0) throw file_error("cannot write", path_, errno);
    done += static_cast<std::size_t>(written);
    if (done % page_size != 0) break;
  }
  return done - done % page_size;
}

void AtomicFile::write_at(std::size_t offset, const void* data, std::size_t size) {
  const char* const bytes = static_cast<const char*>(data);
  const std::size_t head = (page_size - offset % page_size) % page_size;
  const bool in_step = (reinterpret_cast<std::uintptr_t>(bytes) + head) % page_size == 0;
  if (direct_ < 0 || !in_step || size < head + page_size) return write_whole(descriptor_, offset, bytes, size, path_);
  const std::size_t rest = head + write_directly(offset + head, bytes + head, size - head);
  write_whole(descriptor_, offset, bytes, head, path_);
  write_whole(descriptor_, offset + rest, bytes + rest, size - rest, path_);
}

void AtomicFile::expect(std::size_t size) {
  // File systems that cannot do these do without.
#ifdef __linux__
  if (::fallocate(descriptor_, 0, 0, static_cast<off_t>(size)) != 0 && errno == ENOSPC)
    throw file_error("cannot write", path_, errno);
  if (size >= large_file && direct_ < 0) direct_ = ::open(temporary_.c_str(), O_RDWR | O_DIRECT | O_CLOEXEC);
#endif
}

void AtomicFile::commit() {
  if (direct_ >= 0) ::close(std::exchange(direct_, -1));
  if (::fsync(descriptor_) != 0) throw file_error("cannot write", path_, errno);
  if (::close(std::exchange(descriptor_, -1)) != 0) throw file_error("cannot write", path_, errno);
  if (::rename(temporary_.c_str(), path_.c_str()) != 0) throw file_error("cannot write", path_, errno);
  temporary_.clear();
  sync_folder(path_.parent_path());
}

void write_file(const std::filesystem::path& path, std::string_view bytes) {
  AtomicFile file(path);
  file.write(bytes);
  file.commit();
}

void create_folder(const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) throw file_error("cannot create folder", folder, error.value());
  if (!std::filesystem::is_directory(folder)) throw file_error("cannot create folder", folder, ENOTDIR);
  if (::access(folder.c_str(), W_OK | X_OK) != 0) throw file_error("cannot write in folder", folder, errno);
}

}  // namespace malus
