#pragma once

#include <cstddef>
#include <cstring>

#include "malus/core/large_allocator.h"
#include "malus/core/parallel_internal.h"
#include "malus/io/atomic_file_internal.h"

namespace malus {

/// A block of bytes and its offset in a file.
class FileBlock {
 public:
  FileBlock(std::size_t offset, std::size_t size) : offset_(offset), bytes_(size) {}

  /// Puts a value behind those before it; together they are as long as the block.
  template <class T>
  void put(const T& value) {
    std::memcpy(at_, &value, sizeof value);
    at_ += sizeof value;
  }
  void write_to(AtomicFile& file) const { file.write_at(offset_, bytes_.data(), bytes_.size()); }

 private:
  std::size_t offset_;
  LargeVector<char> bytes_;
  char* at_ = bytes_.data();
};

/// Writes `count` records of `size` bytes each at `offset`, on all threads: put(i, block) puts record i.
template <class Put>
void write_records(AtomicFile& file, std::size_t offset, std::size_t count, std::size_t size, const Context& context,
                   Put&& put) {
  // Large enough for a disk, small enough to stay in the processor's cache where the system copies it.
  constexpr std::size_t block_bytes = 1 << 20;
  parallel_for(context, count, block_bytes / size, [&](std::size_t first, std::size_t last) {
    FileBlock block(offset + first * size, (last - first) * size);
    for (std::size_t i = first; i < last; ++i) put(i, block);
    block.write_to(file);
  });
}

}  // namespace malus
