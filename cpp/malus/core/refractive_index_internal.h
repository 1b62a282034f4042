#pragma once

namespace malus {

/// Refractive indices that the library takes, in station files and on arrays alike.
inline constexpr double least_refractive_index = 1.05, largest_refractive_index = 3;

}  // namespace malus
