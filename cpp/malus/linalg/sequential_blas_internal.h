#pragma once

namespace malus {

/// While an object of this class lives, OpenBLAS and the OpenMP loops that CHOLMOD starts from the calling thread run
/// on that thread alone. Their own threads would compete with ours for the cores and spin while they wait (measured:
/// twice the processor time, for no gain), and the last digits of the results would depend on their number. Throws
/// ErrorCode::resource when there is no memory for OpenBLAS's buffers; OpenBLAS itself would retry forever.
class SequentialBlas {
 public:
  SequentialBlas();
  ~SequentialBlas();
  SequentialBlas(const SequentialBlas&) = delete;
  SequentialBlas& operator=(const SequentialBlas&) = delete;

 private:
  int openmp_levels_before_;
};

}  // namespace malus
