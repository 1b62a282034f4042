#include <omp.h>

#include <mutex>

#include "malus/linalg/sequential_blas_internal.h"

extern "C" {
int openblas_get_num_threads();
void openblas_set_num_threads(int count);
}

namespace malus {
namespace {

// OpenBLAS has one count for the process: the first user saves it, the last one puts it back.
std::mutex mutex;
int users = 0, threads_before = 1;

}  // namespace

SequentialBlas::SequentialBlas() : openmp_levels_before_(omp_get_max_active_levels()) {
  const std::lock_guard lock(mutex);
  if (users++ == 0) {
    threads_before = openblas_get_num_threads();
    openblas_set_num_threads(1);
  }
  omp_set_max_active_levels(0);  // holds for the calling thread
}

SequentialBlas::~SequentialBlas() {
  omp_set_max_active_levels(openmp_levels_before_);
  const std::lock_guard lock(mutex);
  if (--users == 0) openblas_set_num_threads(threads_before);
}

}  // namespace malus
