#include <algorithm>
#include <array>
#include <cstring>
#include <fstream>
#include <iterator>
#include <sstream>

#include "malus/io/ply_header_internal.h"

namespace malus {
namespace {

/// The types in the order of PlyType; each has two names.
struct TypeEntry {
  std::string_view name, name_with_bits;
  std::size_t bytes;
};
constexpr std::array<TypeEntry, 8> types{{{"char", "int8", 1},
                                          {"uchar", "uint8", 1},
                                          {"short", "int16", 2},
                                          {"ushort", "uint16", 2},
                                          {"int", "int32", 4},
                                          {"uint", "uint32", 4},
                                          {"float", "float32", 4},
                                          {"double", "float64", 8}}};

std::vector<std::string> words_of(std::string_view line) {
  std::istringstream words{std::string(line)};
  return std::vector<std::string>(std::istream_iterator<std::string>(words), {});
}

PlyType type_of(const InputFile& file, const std::string& name) {
  for (std::size_t type = 0; type < types.size(); ++type) {
    if (name == types[type].name || name == types[type].name_with_bits) return static_cast<PlyType>(type);
  }
  throw file.error("has an unknown property type \"" + name + "\" in its header");
}

PlyFormat format_of(const InputFile& file, const std::string& name) {
  if (name == "ascii") return PlyFormat::ascii;
  if (name == "binary_little_endian") return PlyFormat::little_endian;
  if (name == "binary_big_endian") return PlyFormat::big_endian;
  throw file.error("has the unknown format \"" + name + "\"");
}

PlyProperty property_of(const InputFile& file, const std::vector<std::string>& words) {
  if (words.size() == 3) return {words[2], type_of(file, words[1]), std::nullopt};
  if (words.size() == 5 && words[1] == "list") {
    const PlyType count = type_of(file, words[2]);
    if (count == PlyType::float32 || count == PlyType::float64)
      throw file.error("counts a list in floating-point numbers");
    return {words[4], type_of(file, words[3]), count};
  }
  throw file.error("has a malformed property in line " + std::to_string(file.line_number()));
}

PlyElement element_of(const InputFile& file, const std::vector<std::string>& words) {
  const auto count = number_of<std::uint64_t>(words.back());
  if (words.size() != 3 || !count)
    throw file.error("has a malformed element in line " + std::to_string(file.line_number()));
  return {words[1], *count, {}};
}

}  // namespace

std::size_t size_of(PlyType type) {
  return types[static_cast<std::size_t>(type)].bytes;
}

bool PlyElement::has_lists() const {
  return std::any_of(properties.begin(), properties.end(),
                     [](const PlyProperty& p) { return p.list_count.has_value(); });
}

std::size_t PlyElement::smallest_record() const {
  std::size_t bytes = 0;
  for (const PlyProperty& property : properties) bytes += size_of(property.list_count.value_or(property.type));
  return bytes;
}

bool is_ply(const std::filesystem::path& path) {
  char magic[4] = {};
  std::ifstream(path, std::ios::binary).read(magic, sizeof magic);
  return std::memcmp(magic, "ply", 3) == 0 && (magic[3] == '\n' || magic[3] == '\r');
}

PlyHeader read_ply_header(InputFile& file) {
  constexpr std::size_t most_lines = 10000;
  PlyHeader header;
  bool has_format = false;
  std::string_view line;
  file.read_line(line);
  while (file.line_number() < most_lines && file.read_line(line)) {
    const std::vector<std::string> words = words_of(line);
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
