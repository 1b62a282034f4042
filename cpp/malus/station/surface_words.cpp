#include <optional>
#include <sstream>
#include <string>

#include "malus/core/digits_internal.h"
#include "malus/core/version.h"
#include "malus/fusion/refinement_verdict_internal.h"
#include "malus/station/surface_words_internal.h"

namespace malus {
namespace {

/// The text in one line: each run of blanks and line ends becomes one blank.
std::string in_one_line(const std::string& text) {
  std::istringstream words(text);
  std::string line;
  for (std::string word; words >> word;) line += (line.empty() ? "" : " ") + word;
  return line;
}

/// A share that quality.json states; nothing if it is not known.
std::optional<double> share_at(const Json& quality, const std::string& path) {
  const Json::json_pointer place(path);
  if (!quality.contains(place) || quality.at(place).is_null()) return std::nullopt;
  return quality.at(place).get<double>();
}

/// How much of the surface is finer than the prior.
std::string origin_of_detail(const Json& quality) {
  const std::optional<double> share = refined_share(quality);
  if (!share) return "detail from polarization everywhere, which nothing proves";
  if (*share < refined_nowhere) return "the surface is the prior's (the coarse surface it was made from), no finer";
  if (*share >= refined_everywhere) return "detail from polarization on nearly all of the object";
  return "detail from polarization on " + percent(*share) + " of the object, elsewhere the prior's surface, no finer";
}

/// The fields of [object] that are not empty.
Json catalog_of(const Json& quality) {
  Json words = Json::object();
  if (!quality.contains("object")) return words;
  for (const auto& [key, value] : quality.at("object").items())
    if (value.is_string() && !value.get<std::string>().empty()) words[key] = value;
  return words;
}

}  // namespace

std::optional<double> refined_share(const Json& quality) {
  const std::optional<double> trusted = share_at(quality, "/refinement/trusted_share");
  if (!trusted) return std::nullopt;
  // That is a share of the pixels whose polarization was used: the valid ones, except, with a map of the surroundings,
  // those that mirror the object itself. On all others nothing finer than the prior is known.
  const double valid = share_at(quality, "/polarization/valid_fraction").value_or(1);
  const double left_out = share_at(quality, "/refinement/surroundings/self_mirroring_share").value_or(0);
  return *trusted * valid * (1 - left_out);
}

Json surface_words(const Json& quality) {
  const Json& confidence = quality.at("confidence");
  const std::string unit = quality.at("unit");
  const std::string pixel = with_digits(quality.at("gsd").get<double>(), 4) + " " + unit;
  std::string reasons;
  for (const std::string reason : confidence.at("reasons")) reasons += reason + ' ';
  Json said = {{"title", quality.at("name")}};
  said.update(catalog_of(quality));
  said.update({{"unit", unit},
               {"pixel", pixel},
               {"confidence", confidence.at("level")},
               {"reasons", reasons},
               {"detail", origin_of_detail(quality)},
               {"made_by", std::string("Malus ") + version}});
  Json lines = Json::object();
  for (const auto& [key, value] : said.items())
    if (const std::string line = in_one_line(value); !line.empty()) lines[key] = line;
  return lines;
}

Json surface_extras(const Json& quality, const Json& versions) {
  return {{"object", catalog_of(quality)},
          {"station", quality.at("name")},
          {"unit_of_the_station", quality.at("unit")},
          {"gsd", quality.at("gsd")},
          {"confidence", quality.at("confidence")},
          {"detail", origin_of_detail(quality)},
          {"versions", versions}};
}

Json all_versions() {
  Json versions = {{"malus", version}};
  for (const auto& [library, number] : library_versions) versions[library] = number;
  return versions;
}

}  // namespace malus
