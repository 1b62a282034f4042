#pragma once

namespace malus {

/// While one lives, OpenBLAS and the OpenMP loops that CHOLMOD starts from the calling thread run on that thread alone.
/// Their own threads would fight with ours for the cores and spin while they wait (measured: twice the processor time,
/// for no gain), and their number would show in the last digits of the results.
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
