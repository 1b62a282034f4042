#include "malus/linalg/sequential_blas.h"

#include <dlfcn.h>

#include <mutex>

namespace malus {
namespace {

using GetNumber = int (*)();
using SetNumber = void (*)(int);

/// Function of a library that is loaded, also when only an extension module has loaded it (then it is not visible by
/// default); null if there is none.
void* find(const char* library, const char* function) {
  if (void* handle = dlopen(library, RTLD_LAZY | RTLD_NOLOAD)) {
    void* found = dlsym(handle, function);
    dlclose(handle);
    if (found != nullptr) return found;
  }
  return dlsym(RTLD_DEFAULT, function);
}

struct OpenBlas {
  GetNumber get = reinterpret_cast<GetNumber>(find("libblas.so.3", "openblas_get_num_threads"));
  SetNumber set = reinterpret_cast<SetNumber>(find("libblas.so.3", "openblas_set_num_threads"));
  std::mutex mutex;
  int users = 0;
  int threads_before = 1;
};

struct OpenMp {
  GetNumber get = reinterpret_cast<GetNumber>(find("libgomp.so.1", "omp_get_max_active_levels"));
  SetNumber set = reinterpret_cast<SetNumber>(find("libgomp.so.1", "omp_set_max_active_levels"));
};

OpenBlas& open_blas() {
  static OpenBlas instance;
  return instance;
}

const OpenMp& open_mp() {
  static const OpenMp instance;
  return instance;
}

}  // namespace

SequentialBlas::SequentialBlas() {
  OpenBlas& blas = open_blas();
  if (blas.get != nullptr && blas.set != nullptr) {
    // The count is the process's: the first user saves it, the last one puts it back.
    const std::lock_guard lock(blas.mutex);
    if (blas.users++ == 0) {
      blas.threads_before = blas.get();
      blas.set(1);
    }
  }
  const OpenMp& openmp = open_mp();
  if (openmp.get != nullptr && openmp.set != nullptr) {
    openmp_levels_before_ = openmp.get();
    openmp.set(0);  // holds for the calling thread
  }
}

SequentialBlas::~SequentialBlas() {
  OpenBlas& blas = open_blas();
  if (blas.get != nullptr && blas.set != nullptr) {
    const std::lock_guard lock(blas.mutex);
    if (--blas.users == 0) blas.set(blas.threads_before);
  }
  const OpenMp& openmp = open_mp();
  if (openmp.get != nullptr && openmp.set != nullptr) openmp.set(openmp_levels_before_);
}

}  // namespace malus
