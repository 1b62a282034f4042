#include "malus/core/large_allocator.h"

#include "malus/core/kept_memory.h"

#ifdef __linux__
#include <pthread.h>
#include <sys/mman.h>

#include <algorithm>
#include <cstdint>
#include <iterator>
#include <map>
#include <mutex>
#endif

namespace malus {
namespace {

constexpr std::size_t huge_page = std::size_t{2} << 20;
/// Below, memory is used again by what comes next, and a huge page would often be half empty.
constexpr std::size_t large = 2 * huge_page;

#ifdef __linux__

/// The memory of large blocks: whole huge pages of the system's, and those that are kept for the next block.
class LargeMemory {
 public:
  void* allocate(std::size_t bytes) {
    const std::size_t size = pages_of(bytes);
    {
      const std::lock_guard lock(mutex_);
      if (char* const kept = take_kept(size)) return kept;
      // In its place, so that what is kept is never added to what the program needs.
      give_back(size);
    }
    void* const mapped = ::mmap(nullptr, size + huge_page, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (mapped == MAP_FAILED) throw std::bad_alloc();
    char* const begin = static_cast<char*>(mapped);
    const std::size_t before = (huge_page - reinterpret_cast<std::uintptr_t>(begin) % huge_page) % huge_page;
    if (before > 0) ::munmap(begin, before);
    ::munmap(begin + before + size, huge_page - before);
    // A system that cannot do it uses small pages.
    ::madvise(begin + before, size, MADV_HUGEPAGE);
    return begin + before;
  }

  void free(void* memory, std::size_t bytes) noexcept {
    const std::size_t size = pages_of(bytes);
    {
      const std::lock_guard lock(mutex_);
      if (keepers_ > 0 && keep(static_cast<char*>(memory), size)) return;
    }
    ::munmap(memory, size);
  }

  void add_keeper() {
    const std::lock_guard lock(mutex_);
    ++keepers_;
  }
  void remove_keeper() {
    const std::lock_guard lock(mutex_);
    if (--keepers_ == 0) give_back(std::numeric_limits<std::size_t>::max());
  }

  void limit(std::size_t bytes) {
    const std::lock_guard lock(mutex_);
    std::size_t kept = 0;
    for (const auto& part : kept_) kept += part.second;
    if (kept > bytes) give_back(pages_of(kept - bytes));
  }

  void lock() { mutex_.lock(); }
  void unlock() { mutex_.unlock(); }

 private:
  static std::size_t pages_of(std::size_t bytes) { return (bytes + huge_page - 1) / huge_page * huge_page; }

  /// From the smallest part that is large enough.
  char* take_kept(std::size_t size) {
    auto best = kept_.end();
    for (auto part = kept_.begin(); part != kept_.end(); ++part) {
      if (part->second >= size && (best == kept_.end() || part->second < best->second)) best = part;
    }
    if (best == kept_.end()) return nullptr;
    char* const begin = best->first;
    shrink(best, size);
    return begin;
  }

  void give_back(std::size_t size) {
    while (size > 0 && !kept_.empty()) {
      const auto part = kept_.begin();
      const std::size_t length = std::min(size, part->second);
      ::munmap(part->first, length);
      shrink(part, length);
      size -= length;
    }
  }

  /// Takes the beginning of a part out.
  void shrink(std::map<char*, std::size_t>::iterator part, std::size_t size) {
    auto node = kept_.extract(part);
    node.key() += size;
    node.mapped() -= size;
    if (node.mapped() > 0) kept_.insert(std::move(node));
  }

  bool keep(char* begin, std::size_t size) noexcept {
    try {
      auto part = kept_.emplace(begin, size).first;
      if (const auto next = std::next(part); next != kept_.end() && begin + size == next->first) {
        part->second += next->second;
        kept_.erase(next);
      }
      if (part == kept_.begin()) return true;
      if (const auto previous = std::prev(part); previous->first + previous->second == begin) {
        previous->second += part->second;
        kept_.erase(part);
      }
      return true;
    } catch (const std::bad_alloc&) {
      return false;
    }
  }

  std::mutex mutex_;
  std::map<char*, std::size_t> kept_;  ///< length of each part; none touches another
  int keepers_ = 0;
};

/// Never destroyed: objects that are destroyed at the end of the program may have memory of it.
LargeMemory& large_memory() {
  static LargeMemory* const memory = [] {
    static LargeMemory* const made = new LargeMemory;
    // No other thread of the child could unlock what one of the parent has locked.
    pthread_atfork([] { made->lock(); }, [] { made->unlock(); }, [] { made->unlock(); });
    return made;
  }();
  return *memory;
}

#endif

}  // namespace

#ifdef __linux__

void* allocate_large(std::size_t bytes) {
  return bytes < large ? ::operator new(bytes) : large_memory().allocate(bytes);
}

void free_large(void* memory, std::size_t bytes) noexcept {
  bytes < large ? ::operator delete(memory) : large_memory().free(memory, bytes);
}

KeptMemory::KeptMemory() {
  large_memory().add_keeper();
}

KeptMemory::~KeptMemory() {
  large_memory().remove_keeper();
}

void KeptMemory::limit(std::size_t bytes) {
  large_memory().limit(bytes);
}

#else

void* allocate_large(std::size_t bytes) {
  return bytes < large ? ::operator new(bytes) : ::operator new(bytes, std::align_val_t{huge_page});
}

void free_large(void* memory, std::size_t bytes) noexcept {
  bytes < large ? ::operator delete(memory) : ::operator delete(memory, std::align_val_t{huge_page});
}

KeptMemory::KeptMemory() = default;
KeptMemory::~KeptMemory() = default;
void KeptMemory::limit(std::size_t /*bytes*/) {}

#endif

}  // namespace malus
