#pragma once

#include <sstream>
#include <string>

#include "malus/core/error.h"

namespace malus {

/// Range of refractive indices that the library accepts, both in station files and with arrays.
inline constexpr double least_refractive_index = 1.05, largest_refractive_index = 3;

/// The index, if the library accepts it; else throws an input error that names it.
inline double accepted_refractive_index(double eta, const std::string& name) {
  if (eta >= least_refractive_index && eta <= largest_refractive_index) return eta;
  std::ostringstream message;
  message << name << " = " << eta << ", expected a value from " << least_refractive_index << " to "
          << largest_refractive_index;
  throw input_error(message.str());
}

}  // namespace malus
