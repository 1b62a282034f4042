#include <fcntl.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <system_error>
#include <utility>

#include "malus/io/atomic_file_internal.h"
#include "malus/io/input_file_internal.h"

namespace malus {
namespace {

constexpr std::string_view partial_mark = ".partial-";

std::filesystem::path temporary_name(const std::filesystem::path& path) {
  static std::atomic<unsigned> counter{0};
  std::filesystem::path name(".");
  name += path.filename();
  name += std::string(partial_mark) + std::to_string(::getpid()) + "-" + std::to_string(counter.fetch_add(1));
  return path.parent_path() / name;
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

bool is_unfinished(const std::filesystem::path& path) {
  const std::string name = path.filename().string();
  return name.starts_with('.') && name.find(partial_mark) != std::string::npos;
}

AtomicFile::AtomicFile(std::filesystem::path path) : path_(std::move(path)), temporary_(temporary_name(path_)) {
  if (std::filesystem::is_directory(path_)) throw file_error("cannot write", path_, EISDIR);
  descriptor_ = ::open(temporary_.c_str(), O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  if (descriptor_ < 0) throw file_error("cannot write", path_, errno);
}

AtomicFile::~AtomicFile() {
  if (descriptor_ >= 0) ::close(descriptor_);
  if (!temporary_.empty()) ::unlink(temporary_.c_str());
}

void AtomicFile::write(const void* data, std::size_t size) {
  write_at(end_, data, size);
  end_ += size;
}

void AtomicFile::write_at(std::size_t offset, const void* data, std::size_t size) {
  const char* const bytes = static_cast<const char*>(data);
  for (std::size_t done = 0; done < size;) {
    const ssize_t written = ::pwrite(descriptor_, bytes + done, size - done, static_cast<off_t>(offset + done));
    if (written >= 0) {
      done += static_cast<std::size_t>(written);
    } else if (errno != EINTR) {
      throw file_error("cannot write", path_, errno);
    }
  }
}

void AtomicFile::expect(std::size_t size) {
  // Not every file system can reserve room; only a full disk is an error.
#ifdef __linux__
  if (::fallocate(descriptor_, 0, 0, static_cast<off_t>(size)) != 0 && errno == ENOSPC)
    throw file_error("cannot write", path_, errno);
#endif
}

void AtomicFile::commit() {
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
  require_utf8(folder, "folder");
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) throw file_error("cannot create folder", folder, error.value());
  if (!std::filesystem::is_directory(folder)) throw file_error("cannot create folder", folder, ENOTDIR);
  if (::access(folder.c_str(), W_OK | X_OK) != 0) throw file_error("cannot write in folder", folder, errno);
}

}  // namespace malus
