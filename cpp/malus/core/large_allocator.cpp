#include "malus/core/large_allocator.h"

#ifdef __linux__
#include <sys/mman.h>
#endif

namespace malus {
namespace {

constexpr std::size_t huge_page = std::size_t{2} << 20;
/// Below, memory is used again by what comes next, and a huge page would often be half empty.
constexpr std::size_t large = 2 * huge_page;

}  // namespace

void* allocate_large(std::size_t bytes) {
  if (bytes < large) return ::operator new(bytes);
  void* const memory = ::operator new(bytes, std::align_val_t{huge_page});
#ifdef __linux__
  // A system that cannot do it uses small pages.
  madvise(memory, bytes, MADV_HUGEPAGE);
#endif
  return memory;
}

void free_large(void* memory, std::size_t bytes) noexcept {
  if (bytes < large) {
    ::operator delete(memory);
  } else {
    ::operator delete(memory, std::align_val_t{huge_page});
  }
}

}  // namespace malus
