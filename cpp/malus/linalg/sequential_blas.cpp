#include <omp.h>
#include <sys/mman.h>

#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "malus/core/error.h"
#include "malus/linalg/sequential_blas_internal.h"

extern "C" {
int openblas_get_num_threads();
void openblas_set_num_threads(int count);
void* blas_memory_alloc(int purpose);
void blas_memory_free(void* buffer);
}

namespace malus {
namespace {

// OpenBLAS has one thread count per process: the first user saves it, the last one restores it.
std::mutex mutex;
std::size_t users = 0;
int threads_before = 1;
/// Buffers that OpenBLAS has allocated; it never frees them.
std::set<const void*> buffers;

/// Size of one OpenBLAS buffer on x86-64.
constexpr std::size_t buffer_bytes = std::size_t{128} << 20;

void require_memory(std::size_t bytes) {
  void* const place = ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (place == MAP_FAILED) {
    throw resource_error("out of memory: the linear solver needs " + std::to_string(bytes >> 20) +
                         " MB of address space more; raise the limit (ulimit -v), or run with fewer threads");
  }
  ::munmap(place, bytes);
}

/// Makes OpenBLAS allocate one buffer per user in advance. Otherwise OpenBLAS allocates when it is called, and retries
/// forever if the system refuses.
void reserve_buffers() {
  struct Taken : std::vector<void*> {
    ~Taken() {
      for (void* buffer : *this) blas_memory_free(buffer);
    }
  } taken;
  while (buffers.size() < users) {
    // Room for one more, in case another thread takes the buffers meanwhile.
    require_memory(2 * buffer_bytes);
    taken.push_back(blas_memory_alloc(0));
    buffers.insert(taken.back());
  }
}

/// One user less.
void release() {
  if (--users == 0) openblas_set_num_threads(threads_before);
}

}  // namespace

SequentialBlas::SequentialBlas() : openmp_levels_before_(omp_get_max_active_levels()) {
  const std::lock_guard lock(mutex);
  if (users++ == 0) {
    threads_before = openblas_get_num_threads();
    openblas_set_num_threads(1);
  }
  try {
    reserve_buffers();
  } catch (...) {
    release();
    throw;
  }
  omp_set_max_active_levels(0);  // holds for the calling thread
}

SequentialBlas::~SequentialBlas() {
  omp_set_max_active_levels(openmp_levels_before_);
  const std::lock_guard lock(mutex);
  release();
}

}  // namespace malus
