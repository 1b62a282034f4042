#pragma once

// Multiplies constants by factors from an environment variable. varied_source.py inserts this into an instrumented copy
// of the sources.
//
// MALUS_VARIED="file.cpp:name=0.5,…": factors. MALUS_REACHED=FILE: the names of constants whose code was executed are
// appended to FILE; constants at namespace scope always are.

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <type_traits>

namespace malus_varied {

inline double factor(const char* key) {
  if (const char* path = std::getenv("MALUS_REACHED")) {
    if (std::FILE* file = std::fopen(path, "a")) {
      std::fprintf(file, "%s\n", key);
      std::fclose(file);
    }
  }
  const char* varied = std::getenv("MALUS_VARIED");
  if (varied == nullptr) return 1;
  const std::string all = "," + std::string(varied), wanted = "," + std::string(key) + "=";
  const std::size_t at = all.find(wanted);
  return at == std::string::npos ? 1 : std::atof(all.c_str() + at + wanted.size());
}

/// The value times its factor. Whole numbers are rounded and at least 1.
template <class T>
T of(const char* key, T value) {
  const double by = factor(key);
  if (by == 1) return value;
  if constexpr (std::is_integral_v<T>) {
    return static_cast<T>(std::fmax(1, std::round(by * static_cast<double>(value))));
  } else {
    return static_cast<T>(by * value);
  }
}

template <class T, std::size_t N>
std::array<T, N> of(const char* key, std::array<T, N> values) {
  const double by = factor(key);
  for (T& value : values) value = static_cast<T>(by * value);
  return values;
}

}  // namespace malus_varied

/// The same for a number without a name; evaluated once.
#define MALUS_VARIED_VALUE(key, value)                                                \
  ([]() -> std::decay_t<decltype(value)> {                                            \
    static const std::decay_t<decltype(value)> varied = malus_varied::of(key, value); \
    return varied;                                                                    \
  }())
