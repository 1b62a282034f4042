#include "shared_data.h"

namespace malus {

std::filesystem::path shared_data() {
  return MALUS_SOURCE_DIR "/../shared/data";
}

}  // namespace malus
