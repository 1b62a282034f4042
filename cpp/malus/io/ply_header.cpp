#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <type_traits>

#include "malus/io/ply_header_internal.h"

namespace malus {
namespace {

using PlyWords = std::vector<std::string_view>;

template <class T>
double value_of(const unsigned char* bytes, bool swap) {
  std::array<unsigned char, sizeof(T)> raw;
  std::memcpy(raw.data(), bytes, sizeof(T));
  if (swap) std::reverse(raw.begin(), raw.end());
  return static_cast<double>(std::bit_cast<T>(raw));
}

template <class T>
constexpr PlyType ply_type(std::string_view name, std::string_view name_with_bits) {
  return {name, name_with_bits, sizeof(T), std::is_floating_point_v<T>, value_of<T>};
}

constexpr std::array ply_types{ply_type<std::int8_t>("char", "int8"),    ply_type<std::uint8_t>("uchar", "uint8"),
                               ply_type<std::int16_t>("short", "int16"), ply_type<std::uint16_t>("ushort", "uint16"),
                               ply_type<std::int32_t>("int", "int32"),   ply_type<std::uint32_t>("uint", "uint32"),
                               ply_type<float>("float", "float32"),      ply_type<double>("double", "float64")};

const PlyType* type_of(const InputFile& file, std::string_view name) {
  for (const PlyType& type : ply_types) {
    if (name == type.name || name == type.name_with_bits) return &type;
  }
  throw file.error("has an unknown property type \"" + std::string(name) + "\" in its header");
}

PlyFormat format_of(const InputFile& file, std::string_view name) {
  if (name == "ascii") return PlyFormat::ascii;
  if (name == "binary_little_endian") return PlyFormat::little_endian;
  if (name == "binary_big_endian") return PlyFormat::big_endian;
  throw file.error("has the unknown format \"" + std::string(name) + "\"");
}

PlyProperty property_of(const InputFile& file, const PlyWords& words) {
  if (words.size() == 3) return {std::string(words[2]), type_of(file, words[1]), nullptr};
  if (words.size() == 5 && words[1] == "list") {
    const PlyType* const count = type_of(file, words[2]);
    if (count->is_floating) throw file.error("counts a list in floating-point numbers");
    return {std::string(words[4]), type_of(file, words[3]), count};
  }
  throw file.error("has a malformed property in line " + std::to_string(file.line_number()));
}

PlyElement element_of(const InputFile& file, const PlyWords& words) {
  const auto count = number_of<std::uint64_t>(words.back());
  if (words.size() != 3 || !count)
    throw file.error("has a malformed element in line " + std::to_string(file.line_number()));
  return {std::string(words[1]), *count, {}};
}

}  // namespace

bool PlyElement::has_lists() const {
  return std::ranges::any_of(properties, [](const PlyProperty& p) { return p.list_count != nullptr; });
}

std::size_t PlyElement::smallest_record() const {
  std::size_t bytes = 0;
  for (const PlyProperty& property : properties) bytes += property.first_type().bytes;
  return bytes;
}

bool is_ply(InputFile& file) {
  const std::string_view start = file.buffered().substr(0, 4);
  return start == "ply\n" || start == "ply\r";
}

PlyHeader read_ply_header(InputFile& file) {
  constexpr std::size_t most_lines = 10000;
  PlyHeader header;
  bool has_format = false;
  std::string_view line;
  PlyWords words;
  file.read_line(line);
  while (file.line_number() < most_lines && file.read_line(line)) {
    split_words(line, words, " \t");
    if (words.empty() || words[0] == "comment" || words[0] == "obj_info") continue;
    if (words[0] == "end_header") {
      if (!has_format) throw file.error("has no format in its header");
      return header;
    }
    if (words[0] == "format" && words.size() >= 2) {
      header.format = format_of(file, words[1]);
      has_format = true;
    } else if (words[0] == "element") {
      header.elements.push_back(element_of(file, words));
    } else if (words[0] == "property" && !header.elements.empty()) {
      header.elements.back().properties.push_back(property_of(file, words));
    } else {
      throw file.error("has an unknown line in its header: \"" + std::string(line.substr(0, 60)) + "\"");
    }
  }
  throw file.error("has a header without end_header");
}

}  // namespace malus
