#pragma once

#include <cstddef>

namespace malus {

/// While one of these exists, large memory (core/large_allocator.h) that is freed is kept for what is allocated next,
/// in any thread: the system clears fresh pages, and in a virtual machine also gets them from its host, no faster for
/// two threads than for one. What is kept makes room for what it cannot serve, so that large memory is never more than
/// the most that was in use.
class KeptMemory {
 public:
  KeptMemory();
  ~KeptMemory();
  KeptMemory(const KeptMemory&) = delete;
  KeptMemory& operator=(const KeptMemory&) = delete;

  /// Gives all but so many bytes of what is kept back to the system.
  static void limit(std::size_t bytes);
};

}  // namespace malus
