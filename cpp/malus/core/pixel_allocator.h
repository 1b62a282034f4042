#pragma once

#include <cstddef>
#include <limits>
#include <memory>
#include <new>
#include <utility>

namespace malus {

/// Memory for the pixels of an image, not cleared. Large ones begin at a huge page, and the system is asked to use huge
/// pages for them: filled 4 KB at a time, fresh memory costs more than the arithmetic of most steps.
void* allocate_pixels(std::size_t bytes);
void free_pixels(void* memory, std::size_t bytes) noexcept;

/// Allocator of a vector of pixels that leaves them as they are unless a value is given.
template <class T>
struct PixelAllocator {
  using value_type = T;

  PixelAllocator() = default;
  template <class U>
  explicit PixelAllocator(const PixelAllocator<U>&) {}

  T* allocate(std::size_t count) {
    if (count > std::numeric_limits<std::size_t>::max() / sizeof(T)) throw std::bad_array_new_length();
    return static_cast<T*>(allocate_pixels(count * sizeof(T)));
  }
  void deallocate(T* pixels, std::size_t count) noexcept { free_pixels(pixels, count * sizeof(T)); }

  template <class U>
  void construct(U* pixel) {
    ::new (static_cast<void*>(pixel)) U;
  }
  template <class U, class... Values>
  void construct(U* pixel, Values&&... values) {
    ::new (static_cast<void*>(pixel)) U(std::forward<Values>(values)...);
  }

  bool operator==(const PixelAllocator&) const = default;
};

}  // namespace malus
