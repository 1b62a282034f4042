#pragma once

#include <complex>
#include <optional>
#include <string>
#include <string_view>

#include "malus/core/reflection_choice.h"

namespace malus {

/// What optics.metal says of the object.
struct MetalStatement {
  std::string text = "auto";       ///< as stated; a list [n, k] as "n+ki"
  bool excluded = false;           ///< "none": the object is not bare metal
  std::complex<double> index = 0;  ///< n + i k of the metal of which the whole object is; 0 = none is stated

  bool names_metal() const { return index != 0.0; }
};

/// Reads "auto", "none", the name of a metal, or its refractive index such as "0.7+2.6i"; nothing for any other text
/// and for an index that no metal has.
std::optional<MetalStatement> read_metal_statement(std::string_view text);

/// The text of a refractive index.
std::string metal_index_text(double n, double k);

/// What `read_metal_statement` takes, in words.
std::string expected_metal();

/// What is expected in place of a stated metal that contradicts this kind of reflection; nothing if it does not.
std::optional<std::string> expected_metal_with(const MetalStatement& metal, ReflectionChoice reflection);

/// What optics.metal says, if its text is accepted and fits the reflection; else throws an input error that names both.
MetalStatement accepted_metal(const std::string& text, ReflectionChoice reflection);

}  // namespace malus
