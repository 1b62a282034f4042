#pragma once

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <vector>

#include "malus/core/parallel.h"
#include "malus/io/atomic_file.h"

namespace malus {

/// Writes the values of one record after another.
class RecordEncoder {
 public:
  explicit RecordEncoder(char* at) : at_(at) {}

  template <class T>
  void put(const T& value) {
    std::memcpy(at_, &value, sizeof value);
    at_ += sizeof value;
  }

 private:
  char* at_;
};

/// Writes `count` records of `size` bytes each at a place of the file, on all threads: encode(i, encoder) puts record
/// i.
template <class Encode>
void write_records(AtomicFile& file, std::size_t offset, std::size_t count, std::size_t size, const Context& context,
                   Encode&& encode) {
  // Small enough to stay in the processor's cache until the kernel has copied it, which it does for one thread at a
  // time; the others encode meanwhile.
  constexpr std::size_t block_bytes = 1 << 17, blocks_at_once = 8;
  const std::size_t block = block_bytes / size;
  parallel_for(context, count, block * blocks_at_once, [&](std::size_t first, std::size_t last) {
    std::vector<char> bytes(std::min(block, last - first) * size);
    for (std::size_t begin = first; begin < last; begin += block) {
      const std::size_t end = std::min(begin + block, last);
      RecordEncoder encoder(bytes.data());
      for (std::size_t i = begin; i < end; ++i) encode(i, encoder);
      file.write_at(offset + begin * size, bytes.data(), (end - begin) * size);
    }
  });
}

}  // namespace malus
