#include "malus/io/input_file_internal.h"
#include "malus/io/point_columns_internal.h"

namespace malus {

std::size_t slot_of(const std::string& name) {
  const std::string wanted = in_lower_case(name);
  for (std::size_t slot = 0; slot < slot_count; ++slot) {
    for (const std::string_view known : slot_names[slot]) {
      if (!known.empty() && known == wanted) return slot;
    }
  }
  return slot_count;
}

}  // namespace malus
