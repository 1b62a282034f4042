#pragma once

namespace malus {

constexpr double square(double x) {
  return x * x;
}

}  // namespace malus
