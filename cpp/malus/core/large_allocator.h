#pragma once

#include <cstddef>
#include <limits>
#include <memory>
#include <new>
#include <utility>
#include <vector>

namespace malus {

/// Memory that is not cleared. If it is large it begins at a huge page, and the system is asked to use huge pages for
/// it: filled 4 KB at a time, fresh memory costs more than the arithmetic of most steps.
void* allocate_large(std::size_t bytes);
void free_large(void* memory, std::size_t bytes) noexcept;

/// Allocator of vectors that become large: pixels, points. Elements are left as they are unless a value is given.
template <class T>
struct LargeAllocator {
  using value_type = T;

  LargeAllocator() = default;
  template <class U>
  explicit LargeAllocator(const LargeAllocator<U>&) {}

  T* allocate(std::size_t count) {
    if (count > std::numeric_limits<std::size_t>::max() / sizeof(T)) throw std::bad_array_new_length();
    return static_cast<T*>(allocate_large(count * sizeof(T)));
  }
  void deallocate(T* values, std::size_t count) noexcept { free_large(values, count * sizeof(T)); }

  template <class U>
  void construct(U* value) {
    ::new (static_cast<void*>(value)) U;
  }
  template <class U, class... Values>
  void construct(U* value, Values&&... values) {
    ::new (static_cast<void*>(value)) U(std::forward<Values>(values)...);
  }

  bool operator==(const LargeAllocator&) const = default;
};

template <class T>
using LargeVector = std::vector<T, LargeAllocator<T>>;

}  // namespace malus
