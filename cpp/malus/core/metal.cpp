#include <algorithm>
#include <array>
#include <charconv>

#include "malus/core/digits_internal.h"
#include "malus/core/error.h"
#include "malus/core/metal_internal.h"

namespace malus {
namespace {

struct NamedMetal {
  std::string_view name;
  double n, k;
};

// At 550 nm, or at the nearest wavelength of the published table:
// - silver, gold, copper (548.6 nm): P. B. Johnson and R. W. Christy, Phys. Rev. B 6, 4370 (1972);
// - iron (549 nm): P. B. Johnson and R. W. Christy, Phys. Rev. B 9, 5056 (1974);
// - bronze (90 % Cu, 10 % Zn, sold as commercial bronze) and brass (70 % Cu, 30 % Zn), 550 nm: M. R. Querry, Optical
//   constants, CRDC-CR-85034 (1985);
// - lead (550 nm): A. I. Golovashkin and G. P. Motulevich, Sov. Phys. JETP 26, 881 (1968);
// - tin (730 nm, where the table begins): A. I. Golovashkin and G. P. Motulevich, Sov. Phys. JETP 19, 310 (1964);
// - aluminum (563.6 nm): A. D. Rakić, Appl. Opt. 34, 4755 (1995).
constexpr std::array<NamedMetal, 9> named_metals{{
    {"silver", 0.06, 3.586},
    {"gold", 0.43, 2.455},
    {"copper", 1.02, 2.577},
    {"bronze", 0.519, 2.415},
    {"brass", 0.527, 2.765},
    {"iron", 2.95, 2.93},
    {"lead", 1.83, 3.40},
    {"tin", 2.16, 6.35},
    {"aluminum", 1.0728, 6.7839},
}};

// Every metal in visible light lies within these; a dielectric has hardly any k.
constexpr double least_n = 0.01, largest_n = 10, least_k = 0.5, largest_k = 20;

/// "n+ki" with spaces anywhere.
std::optional<std::complex<double>> read_index(std::string_view text) {
  std::string dense(text);
  std::erase(dense, ' ');
  const char* const end = dense.data() + dense.size();
  double n = 0, k = 0;
  const auto [after_n, n_error] = std::from_chars(dense.data(), end, n);
  if (n_error != std::errc() || after_n == end || *after_n != '+') return std::nullopt;
  const auto [after_k, k_error] = std::from_chars(after_n + 1, end, k);
  if (k_error != std::errc() || std::string_view(after_k, end) != "i") return std::nullopt;
  // Not-a-number lies in no range.
  const bool is_metal = n >= least_n && n <= largest_n && k >= least_k && k <= largest_k;
  return is_metal ? std::optional(std::complex<double>(n, k)) : std::nullopt;
}

}  // namespace

std::optional<MetalStatement> read_metal_statement(std::string_view text) {
  MetalStatement metal;
  metal.text = text;
  metal.excluded = text == "none";
  if (text == "auto" || text == "none") return metal;
  const auto known = std::ranges::find(named_metals, text, &NamedMetal::name);
  if (known != named_metals.end()) {
    metal.index = {known->n, known->k};
    return metal;
  }
  const std::optional<std::complex<double>> index = read_index(text);
  if (!index) return std::nullopt;
  metal.index = *index;
  return metal;
}

std::string metal_index_text(double n, double k) {
  return shortest_text(n) + "+" + shortest_text(k) + "i";
}

std::string expected_metal() {
  std::string words = "\"auto\", \"none\", ";
  for (const NamedMetal& metal : named_metals) words.append("\"").append(metal.name).append("\", ");
  return words + "or a metal's refractive index such as [0.7, 2.6] or \"0.7+2.6i\" with n from " +
         shortest_text(least_n) + " to " + shortest_text(largest_n) + " and k from " + shortest_text(least_k) + " to " +
         shortest_text(largest_k);
}

std::optional<std::string> expected_metal_with(const MetalStatement& metal, ReflectionChoice reflection) {
  if (!metal.names_metal()) return std::nullopt;
  if (reflection == ReflectionChoice::diffuse)
    return "\"auto\" or \"none\" with reflection = \"diffuse\", because bare metal only mirrors";
  if (reflection == ReflectionChoice::labels)
    return "\"auto\" or \"none\" with labels of the reflection, because a stated metal is that of the whole object";
  return std::nullopt;
}

MetalStatement accepted_metal(const std::string& text, ReflectionChoice reflection) {
  const std::optional<MetalStatement> metal = read_metal_statement(text);
  const std::optional<std::string> expected = metal ? expected_metal_with(*metal, reflection) : expected_metal();
  if (expected) throw input_error("optics.metal = \"" + text + "\", expected " + *expected);
  return *metal;
}

}  // namespace malus
