#pragma once

// Private to the io room: the header of a PLY file.

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "malus/io/input_file_internal.h"

namespace malus {

/// A type of numbers, which has two names.
struct PlyType {
  std::string_view name, name_with_bits;
  std::size_t bytes;
  bool is_floating;
  double (*value)(const unsigned char*, bool swap);  ///< of a number in a file; `swap` = the other byte order
};
enum class PlyFormat { ascii, little_endian, big_endian };

struct PlyProperty {
  std::string name;
  const PlyType* type = nullptr;
  const PlyType* list_count = nullptr;  ///< type of the length, if the property is a list

  /// Type of the property's first number.
  const PlyType& first_type() const { return list_count ? *list_count : *type; }
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

/// Whether the file starts like a PLY; nothing of it may have been read.
bool is_ply(InputFile& file);

/// Reads the header; the file then stands at the first element.
PlyHeader read_ply_header(InputFile& file);

}  // namespace malus
