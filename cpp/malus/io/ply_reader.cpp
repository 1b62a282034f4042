#include <algorithm>
#include <array>
#include <bit>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "malus/core/digits_internal.h"
#include "malus/io/cloud_builder_internal.h"
#include "malus/io/ply_header_internal.h"
#include "malus/io/ply_reader_internal.h"
#include "malus/io/point_columns_internal.h"

namespace malus {
namespace {

/// Reads the records of one element after another, in any of the formats.
class PlyReader {
 public:
  PlyReader(InputFile& file, PlyFormat format) : file_(file), format_(format) {}

  /// Calls on_record(values, lists) for each record: one value per property (for a list its length) and the elements of
  /// its lists by property.
  template <class OnRecord>
  void read(const PlyElement& element, const Context& context, OnRecord&& on_record) {
    check_count(element);
    values_.assign(element.properties.size(), 0);
    lists_.assign(element.properties.size(), {});
    for (std::uint64_t i = 0; i < element.count; ++i) {
      if (i % records_between_checks == 0) context.check_cancel();
      if (format_ == PlyFormat::ascii) {
        read_text_record(element);
      } else if (element.has_lists()) {
        read_list_record(element);
      } else {
        read_fixed_record(element);
      }
      on_record(values_, lists_);
    }
  }

  void skip(const PlyElement& element, const Context& context) {
    if (format_ != PlyFormat::ascii && !element.has_lists()) {
      check_count(element);
      file_.skip(element.count * element.smallest_record());
    } else {
      read(element, context, [](const auto&, const auto&) {});
    }
  }

 private:
  void check_count(const PlyElement& element) const {
    // A text record has at least one character and one separator per property; the last separator may be missing.
    const bool text = format_ == PlyFormat::ascii;
    const std::uint64_t record =
        std::max<std::uint64_t>(1, text ? 2 * element.properties.size() : element.smallest_record());
    if (element.count > (file_.remaining() + (text ? 1 : 0)) / record) {
      throw file_.error("claims " + std::to_string(element.count) + " elements \"" + element.name +
                        "\", more than its " + std::to_string(file_.size()) + " bytes can hold: truncated or damaged");
    }
  }

  void read_fixed_record(const PlyElement& element) {
    record_.resize(element.smallest_record());
    file_.read(record_.data(), record_.size());
    const unsigned char* bytes = record_.data();
    for (std::size_t p = 0; p < element.properties.size(); ++p) {
      const PlyType& type = *element.properties[p].type;
      values_[p] = type.value(bytes, swap());
      bytes += type.bytes;
    }
  }

  void read_list_record(const PlyElement& element) {
    for (std::size_t p = 0; p < element.properties.size(); ++p) {
      const PlyProperty& property = element.properties[p];
      values_[p] = read_value(property.first_type());
      if (!property.list_count) continue;
      const PlyType& type = *property.type;
      const std::uint64_t length = list_length(values_[p], type.bytes);
      record_.resize(length * type.bytes);
      file_.read(record_.data(), record_.size());
      lists_[p].resize(length);
      for (std::size_t i = 0; i < length; ++i) lists_[p][i] = type.value(record_.data() + i * type.bytes, swap());
    }
  }

  double read_value(const PlyType& type) {
    std::array<unsigned char, 8> bytes;
    file_.read(bytes.data(), type.bytes);
    return type.value(bytes.data(), swap());
  }

  void read_text_record(const PlyElement& element) {
    std::string_view line;
    do {
      if (!file_.read_line(line)) throw file_.error("is truncated: ends before its last \"" + element.name + "\"");
      split_words(line, words_, " \t");
    } while (words_.empty());
    std::size_t next = 0;
    const auto number = [&] {
      double value = 0;
      if (next >= words_.size() || !parse_number(words_[next++], value)) throw malformed_line(file_, line);
      return value;
    };
    for (std::size_t p = 0; p < element.properties.size(); ++p) {
      values_[p] = number();
      if (!element.properties[p].list_count) continue;
      const std::uint64_t length = values_[p] >= 0 ? static_cast<std::uint64_t>(std::min(values_[p], 1e15)) : 0;
      if (values_[p] < 0 || length > words_.size() - next) throw malformed_line(file_, line);
      lists_[p].resize(length);
      for (double& value : lists_[p]) value = number();
    }
  }

  std::uint64_t list_length(double length, std::size_t element_size) const {
    if (!(length >= 0) || length * static_cast<double>(element_size) > static_cast<double>(file_.remaining())) {
      throw file_.error("has a list of " + std::to_string(static_cast<std::int64_t>(length)) +
                        " elements, more than its bytes can hold: truncated or damaged");
    }
    return static_cast<std::uint64_t>(length);
  }

  bool swap() const { return (format_ == PlyFormat::big_endian) == (std::endian::native == std::endian::little); }

  InputFile& file_;
  PlyFormat format_;
  std::vector<double> values_;
  std::vector<std::vector<double>> lists_;
  std::vector<unsigned char> record_;
  std::vector<std::string_view> words_;
};

double color_scale_of(const PlyType& type) {
  if (type.is_floating) return 255;
  return type.bytes == 2 ? 255.0 / 65535 : 1;
}

PointCloud read_ply_vertices(PlyReader& reader, const InputFile& file, const PlyElement& element,
                             const Context& context) {
  PointColumns columns;
  for (std::size_t p = 0; p < element.properties.size(); ++p) {
    const std::size_t slot = slot_of(element.properties[p].name);
    if (slot != slot_count && !element.properties[p].list_count && !columns.column[slot]) columns.column[slot] = p;
  }
  for (const std::size_t slot : {slot_x, slot_y, slot_z}) {
    if (!columns.column[slot]) throw file.error("has vertices without " + std::string(slot_names[slot][0]));
  }
  const auto& red = columns.column[slot_red];
  CloudBuilder builder(columns, red ? color_scale_of(*element.properties[*red].type) : 1);
  bool reserved = false;
  reader.read(element, context, [&](const std::vector<double>& values, const auto&) {
    // Only here, because the reader has now compared the count with the file's size.
    if (!std::exchange(reserved, true)) builder.reserve(element.count);
    builder.add(columns.point(values));
  });
  return builder.finish(file);
}

using Triangles = std::vector<std::array<std::uint32_t, 3>>;

Triangles read_ply_faces(PlyReader& reader, const InputFile& file, const PlyElement& element, std::size_t vertices,
                         const Context& context) {
  const auto property = std::find_if(element.properties.begin(), element.properties.end(), [](const PlyProperty& p) {
    return p.list_count && (p.name == "vertex_indices" || p.name == "vertex_index");
  });
  if (property == element.properties.end()) throw file.error("has faces without a list vertex_indices");
  const auto list = static_cast<std::size_t>(property - element.properties.begin());
  Triangles triangles;
  std::uint64_t face = 0;
  reader.read(element, context, [&](const auto&, const std::vector<std::vector<double>>& lists) {
    const std::vector<double>& polygon = lists[list];
    for (const double index : polygon) {
      if (!(index >= 0 && index < static_cast<double>(vertices))) {
        throw file.error("face " + std::to_string(face) + " has the vertex index " + shortest_text(index) +
                         ", expected 0 to " + std::to_string(vertices - 1));
      }
    }
    for (std::size_t i = 2; i < polygon.size(); ++i) {
      triangles.push_back({static_cast<std::uint32_t>(polygon[0]), static_cast<std::uint32_t>(polygon[i - 1]),
                           static_cast<std::uint32_t>(polygon[i])});
    }
    ++face;
  });
  return triangles;
}

}  // namespace

TriangleMesh read_ply(InputFile& file, PlyParts parts, const Context& context) {
  const PlyHeader header = read_ply_header(file);
  PlyReader reader(file, header.format);
  TriangleMesh mesh;
  for (const PlyElement& element : header.elements) {
    if (element.name == "vertex" && mesh.vertices.points.empty()) {
      mesh.vertices = read_ply_vertices(reader, file, element, context);
      if (parts == PlyParts::vertices) return mesh;
    } else if (element.name == "face" && parts == PlyParts::vertices_and_faces && !mesh.vertices.points.empty()) {
      mesh.triangles = read_ply_faces(reader, file, element, mesh.vertices.points.size(), context);
      return mesh;
    } else {
      reader.skip(element, context);
    }
  }
  if (mesh.vertices.points.empty()) throw file.error("has no element vertex");
  return mesh;
}

}  // namespace malus
