#include <algorithm>
#include <cstddef>
#include <numeric>

#include "malus/io/nearest_name_internal.h"

namespace malus {
namespace {

std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t substituted = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, substituted});
    }
  }
  return row.back();
}

}  // namespace

std::string_view nearest_name(std::string_view name, const std::vector<std::string_view>& known) {
  return *std::min_element(known.begin(), known.end(), [&](std::string_view a, std::string_view b) {
    return edit_distance(name, a) < edit_distance(name, b);
  });
}

std::string hint_at_known_names(std::string_view name, const std::vector<std::string_view>& known,
                                const std::string& before) {
  const std::string_view nearest = nearest_name(name, known);
  // A slip: two swapped letters, or about one wrong letter in three.
  const std::size_t most = std::max<std::size_t>(2, name.size() / 3), distance = edit_distance(name, nearest);
  if (distance <= most && distance < name.size()) return "; did you mean " + before + std::string(nearest) + "?";
  std::string all;
  for (const std::string_view one : known) all += (all.empty() ? "" : ", ") + before + std::string(one);
  return ", expected one of " + all;
}

}  // namespace malus
