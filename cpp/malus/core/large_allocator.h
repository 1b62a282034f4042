#pragma once

#include <memory>
#include <new>
#include <utility>
#include <vector>

namespace malus {

/// Allocator of vectors that become large: pixels, points. Elements stay uninitialized unless a value is given, so the
/// threads that fill a vector share the cost of first access to its memory.
template <class T>
struct LargeAllocator : std::allocator<T> {
  template <class U>
  struct rebind {
    using other = LargeAllocator<U>;
  };

  using std::allocator<T>::allocator;

  template <class U>
  void construct(U* value) {
    ::new (static_cast<void*>(value)) U;
  }
  template <class U, class... Values>
  void construct(U* value, Values&&... values) {
    ::new (static_cast<void*>(value)) U(std::forward<Values>(values)...);
  }
};

template <class T>
using LargeVector = std::vector<T, LargeAllocator<T>>;

}  // namespace malus
