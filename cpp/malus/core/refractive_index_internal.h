#pragma once

namespace malus {

/// Range of refractive indices that the library accepts, both in station files and with arrays.
inline constexpr double least_refractive_index = 1.05, largest_refractive_index = 3;

}  // namespace malus
