#pragma once

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <vector>

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

/// Writes `count` records of `size` bytes each, many at a time: encode(i, encoder) puts record i.
template <class Encode>
void write_records(AtomicFile& file, std::size_t count, std::size_t size, Encode&& encode) {
  // Small enough to stay in the processor's cache until the kernel has copied it.
  constexpr std::size_t block_bytes = 1 << 18;
  const std::size_t block = block_bytes / size;
  std::vector<char> bytes(std::min(block, count) * size);
  for (std::size_t begin = 0; begin < count; begin += block) {
    const std::size_t end = std::min(begin + block, count);
    RecordEncoder encoder(bytes.data());
    for (std::size_t i = begin; i < end; ++i) encode(i, encoder);
    file.write(bytes.data(), (end - begin) * size);
  }
}

}  // namespace malus
