#include "malus/io/input_file_internal.h"
#include "malus/io/station_spec.h"

namespace malus {

std::optional<Response> Response::of(const std::string& text) {
  constexpr std::string_view gamma = "gamma:";
  if (text == "linear") return Response();
  if (text == "srgb") return Response(Kind::srgb, 1, text);
  if (!text.starts_with(gamma)) return Response(Kind::table, 1, text);
  std::vector<std::string_view> words;
  split_words(std::string_view(text).substr(gamma.size()), words, " ");
  const auto exponent = words.size() == 1 ? number_of<double>(words.front()) : std::nullopt;
  if (!exponent || !(*exponent >= 0.1 && *exponent <= 10)) return std::nullopt;
  return Response(Kind::gamma, *exponent, text);
}

}  // namespace malus
