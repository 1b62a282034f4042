#pragma once

// Private to the io room: the header of a PLY file.

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "malus/io/input_file_internal.h"

namespace malus {

enum class PlyType { int8, uint8, int16, uint16, int32, uint32, float32, float64 };
enum class PlyFormat { ascii, little_endian, big_endian };

std::size_t size_of(PlyType type);

struct PlyProperty {
  std::string name;
  PlyType type = PlyType::float32;
  std::optional<PlyType> list_count;  ///< type of the length, if the property is a list
};

struct PlyElement {
  std::string name;
  std::uint64_t count = 0;
  std::vector<PlyProperty> properties;

  bool has_lists() const;
  /// Bytes of a record; if it has lists, the smallest possible number.
  std::size_t smallest_record() const;
};

struct PlyHeader {
  PlyFormat format = PlyFormat::ascii;
  std::vector<PlyElement> elements;
};

/// Whether the file starts like a PLY.
bool is_ply(const std::filesystem::path& path);

/// Reads the header; the file then stands at the first element.
PlyHeader read_ply_header(InputFile& file);

}  // namespace malus
