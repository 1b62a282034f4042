#include <algorithm>
#include <array>
#include <bit>
#include <cctype>
#include <cmath>
#include <optional>
#include <span>
#include <utility>

#include "malus/core/digits_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/io/atomic_file_internal.h"
#include "malus/io/input_file_internal.h"
#include "malus/io/ply_header_internal.h"
#include "malus/io/point_cloud_file_internal.h"
#include "malus/io/record_writer_internal.h"

namespace malus {
namespace {

// ---- meaning of a point's columns or properties ----

enum Slot : std::size_t {
  slot_x,
  slot_y,
  slot_z,
  slot_nx,
  slot_ny,
  slot_nz,
  slot_red,
  slot_green,
  slot_blue,
  slot_count
};

constexpr std::array<std::array<std::string_view, 4>, slot_count> slot_names{{{"x"},
                                                                              {"y"},
                                                                              {"z"},
                                                                              {"nx", "normal_x"},
                                                                              {"ny", "normal_y"},
                                                                              {"nz", "normal_z"},
                                                                              {"red", "r", "diffuse_red"},
                                                                              {"green", "g", "diffuse_green"},
                                                                              {"blue", "b", "diffuse_blue"}}};

std::string in_lower_case(std::string text) {
  std::ranges::transform(text, text.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

/// Slot of a property or column name, or slot_count.
std::size_t slot_of(const std::string& name) {
  const std::string wanted = in_lower_case(name);
  for (std::size_t slot = 0; slot < slot_count; ++slot) {
    for (const std::string_view known : slot_names[slot]) {
      if (!known.empty() && known == wanted) return slot;
    }
  }
  return slot_count;
}

/// The values of one point by slot.
using PointValues = std::array<double, slot_count>;

/// Which column of a text or property of a PLY holds which slot.
struct Columns {
  std::array<std::optional<std::size_t>, slot_count> column{};

  bool has_three(std::size_t slot) const { return column[slot] && column[slot + 1] && column[slot + 2]; }
  void set_three(std::size_t slot, std::size_t first) {
    for (std::size_t i = 0; i < 3; ++i) column[slot + i] = first + i;
  }
  /// The number of columns that a line must have.
  std::size_t count() const {
    std::size_t least = 0;
    for (const auto& index : column) least = std::max(least, index ? *index + 1 : 0);
    return least;
  }
  PointValues point(const std::vector<double>& values) const {
    PointValues found{};
    for (std::size_t slot = 0; slot < slot_count; ++slot) {
      if (column[slot]) found[slot] = values[*column[slot]];
    }
    return found;
  }
};

/// Factor that scales colors of a text to 0 … 255: programs write shares of 1, bytes or numbers of 16 bits.
double scale_of_colors(std::span<const Eigen::Vector3f> values) {
  float largest = 0;
  for (const Eigen::Vector3f& value : values) largest = std::max(largest, value.maxCoeff());
  return largest <= 1 ? 255 : largest <= 255 ? 1 : 255.0 / 65535;
}

/// How much three columns without names look like normals, by all lines: no color is negative, and few have length 1.
/// Zeros are black or an unknown normal, and say nothing.
enum class LikeNormals { no, unknown, by_length, by_sign };

LikeNormals like_normals(std::span<const Eigen::Vector3f> values) {
  constexpr float rounding = 0.02F;
  std::size_t known = 0, of_length_1 = 0;
  for (const Eigen::Vector3f& value : values) {
    if (value.minCoeff() < 0) return LikeNormals::by_sign;
    const float length = value.norm();
    known += length > 0;
    of_length_1 += std::abs(length - 1) < rounding;
  }
  if (known == 0) return LikeNormals::unknown;
  return 2 * of_length_1 >= known ? LikeNormals::by_length : LikeNormals::no;
}

/// Collects points; finds coordinates that are not finite.
class CloudBuilder {
 public:
  /// `color_scale`: nothing where only all colors together show it.
  CloudBuilder(const Columns& columns, std::optional<double> color_scale)
      : has_normals_(columns.has_three(slot_nx)), has_colors_(columns.has_three(slot_red)), color_scale_(color_scale) {}

  void reserve(std::size_t count) {
    cloud_.points.reserve(count);
    if (has_normals_) cloud_.normals.reserve(count);
    if (has_colors_) cloud_.colors.reserve(count);
  }

  void add(const PointValues& values) {
    const Eigen::Vector3d point(values[slot_x], values[slot_y], values[slot_z]);
    if (!point.allFinite() && bad_++ == 0) first_bad_ = cloud_.points.size();
    cloud_.points.push_back(point);
    if (has_normals_) {
      const Eigen::Vector3d normal(values[slot_nx], values[slot_ny], values[slot_nz]);
      cloud_.normals.push_back(normal.allFinite() ? Eigen::Vector3f(normal.cast<float>()) : Eigen::Vector3f::Zero());
    }
    if (!has_colors_) return;
    const Eigen::Vector3d color(values[slot_red], values[slot_green], values[slot_blue]);
    if (color_scale_) {
      cloud_.colors.push_back(rgb(color * *color_scale_));
    } else {
      unscaled_.push_back(color.allFinite() ? Eigen::Vector3f(color.cast<float>()) : Eigen::Vector3f::Zero());
    }
  }

  /// `are_named`: whether the file names the columns; otherwise those taken for colors may be normals.
  PointCloud finish(const InputFile& file, bool are_named = true) {
    if (bad_ > 0) {
      throw file.error(std::to_string(bad_) + " of " + std::to_string(cloud_.points.size()) +
                       " points have coordinates that are not finite (NaN or infinite), the first is number " +
                       std::to_string(first_bad_) + ", counted from 0");
    }
    if (cloud_.points.empty()) throw file.error("has no points");
    if (!are_named) tell_normals_from_colors();
    if (!unscaled_.empty()) {
      const double scale = scale_of_colors(unscaled_);
      cloud_.colors.reserve(unscaled_.size());
      for (const Eigen::Vector3f& color : unscaled_) cloud_.colors.push_back(rgb(color.cast<double>() * scale));
    }
    return std::move(cloud_);
  }

 private:
  /// Six columns have one of both, nine have both, in either order.
  void tell_normals_from_colors() {
    const LikeNormals colors = like_normals(unscaled_);
    if (has_normals_ ? colors > like_normals(cloud_.normals) : colors != LikeNormals::no)
      std::swap(cloud_.normals, unscaled_);
  }

  static Rgb rgb(const Eigen::Vector3d& color) {
    const auto byte = [](double value) {
      const double rounded = std::round(value);
      return static_cast<std::uint8_t>(rounded >= 255 ? 255 : rounded > 0 ? rounded : 0);
    };
    return {byte(color.x()), byte(color.y()), byte(color.z())};
  }

  PointCloud cloud_;
  std::vector<Eigen::Vector3f> unscaled_;  ///< colors whose scale is not known yet
  bool has_normals_, has_colors_;
  std::optional<double> color_scale_;
  std::size_t bad_ = 0, first_bad_ = 0;
};

Error malformed_line(const InputFile& file, std::string_view line, const std::string& expected = "numbers") {
  return file.error("line " + std::to_string(file.line_number()) + " = \"" + std::string(line.substr(0, 60)) +
                    "\", expected " + expected);
}

// ---- PLY ----

constexpr std::uint64_t records_between_checks = 1 << 16;

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
  Columns columns;
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

enum class PlyParts { vertices, vertices_and_faces };

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

// ---- XYZ text ----

bool is_comment_of_text(std::string_view line) {
  return is_comment(line, {"#", "%", "//"});
}

/// Slot of a column's name, which may be in quotes, or slot_count.
std::size_t slot_of_column(std::string_view name) {
  if (name.size() > 2 && name.front() == '"' && name.back() == '"') name = name.substr(1, name.size() - 2);
  return slot_of(std::string(name));
}

/// Columns by the names of a header line, if it names x, y and z. In a comment one of the known names must come first,
/// because any text can have x, y and z somewhere.
std::optional<Columns> columns_of_names(std::string_view line, std::vector<std::string_view>& words) {
  const bool comment = is_comment_of_text(line);
  line.remove_prefix(std::min(line.find_first_not_of("#/% \t"), line.size()));
  split_words(line, words);
  if (words.empty() || (comment && slot_of_column(words[0]) == slot_count)) return std::nullopt;
  Columns columns;
  for (std::size_t i = 0; i < words.size(); ++i) {
    const std::size_t slot = slot_of_column(words[i]);
    if (slot != slot_count && !columns.column[slot]) columns.column[slot] = i;
  }
  return columns.has_three(slot_x) ? std::optional(columns) : std::nullopt;
}

/// Meaning of columns without names; all lines together show which of them are normals instead
/// (CloudBuilder::finish).
Columns columns_of_count(std::size_t count) {
  Columns columns;
  columns.set_three(slot_x, 0);
  if (count == 6 || count == 9) columns.set_three(slot_red, 3);
  if (count == 9) columns.set_three(slot_nx, 6);
  return columns;
}

/// Whether the first of a text's columns numbers the lines, one after the other.
class LineNumbers {
 public:
  void add(double value) {
    if (lines_ == 0) first_ = value;
    in_order_ = in_order_ && value == first_ + static_cast<double>(lines_);
    ++lines_;
  }
  bool found() const {
    constexpr std::size_t few = 10;
    return in_order_ && lines_ >= few;
  }

 private:
  double first_ = 0;
  std::size_t lines_ = 0;
  bool in_order_ = true;
};

/// Whether commas in the line are decimal signs, as programs write them in some countries: the other separators alone
/// divide it into three words or more, and one of these is two numbers with a comma between them. `words` is reused.
bool has_decimal_commas(std::string_view line, std::vector<std::string_view>& words) {
  if (line.find(',') == std::string_view::npos) return false;
  const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
  const auto is_decimal = [&](std::string_view word) {
    if (word.ends_with(',')) word.remove_suffix(1);  // commas divide the columns, too: 1,5, 2,25, 3,75
    const std::size_t comma = word.find(',');
    const bool inside = comma != std::string_view::npos && comma > 0 && comma + 1 < word.size();
    return inside && comma == word.rfind(',') && is_digit(word[comma - 1]) && is_digit(word[comma + 1]);
  };
  split_words(line, words, " \t;");
  return words.size() >= 3 && std::ranges::any_of(words, is_decimal);
}

PointCloud read_xyz(InputFile& file, const Context& context) {
  std::optional<Columns> columns;
  std::optional<CloudBuilder> builder;
  std::vector<std::string_view> words;
  std::vector<double> values;
  LineNumbers numbered;
  std::size_t columns_there = 0;
  bool counted = false, named = false;
  for (std::string_view line; file.read_line(line);) {
    if (file.line_number() % records_between_checks == 0) context.check_cancel();
    const bool first = !builder.has_value();
    constexpr std::string_view byte_order_mark = "\xef\xbb\xbf";
    if (file.line_number() == 1 && line.starts_with(byte_order_mark)) line.remove_prefix(byte_order_mark.size());
    if (first && !columns) {
      columns = columns_of_names(line, words);
      named = columns.has_value();
      if (named) continue;
    }
    if (is_comment_of_text(line)) continue;
    split_words(line, words);
    values.resize(words.size());
    bool numbers = true;
    for (std::size_t i = 0; i < words.size(); ++i) numbers = numbers && parse_number(words[i], values[i]);
    // A first line of other names, or the number of points alone (PTS), which may follow column names (CloudCompare).
    if (first && file.line_number() == 1 && !numbers) continue;
    if (first && numbers && values.size() == 1 && !std::exchange(counted, true)) continue;
    if (!numbers || values.size() < 3) throw malformed_line(file, line);
    if (has_decimal_commas(line, words)) throw malformed_line(file, line, "numbers with decimal points, not commas");
    if (!columns) columns = columns_of_count(values.size());
    if (values.size() < columns->count()) throw malformed_line(file, line);
    if (first) {
      builder.emplace(*columns, std::nullopt);
      columns_there = values.size();
    }
    builder->add(columns->point(values));
    numbered.add(values.front());
  }
  if (!builder) throw file.error("has no points");
  if (!named && columns_there > 3 && numbered.found()) {
    throw file.error(
        "numbers its points in the first column, expected x y z first, or a first line that names the columns, such as "
        "id x y z");
  }
  return builder->finish(file, named);
}

/// Throws for files that are neither PLY nor text; nothing of the file may have been read.
void require_text(InputFile& file) {
  const auto is_of_text = [](char c) {
    return static_cast<unsigned char>(c) >= ' ' || c == '\n' || c == '\r' || c == '\t';
  };
  if (!std::ranges::all_of(file.buffered().substr(0, 512), is_of_text))
    throw file.error("is neither PLY nor text with x y z in each line");
}

// ---- writing ----

static_assert(std::endian::native == std::endian::little, "PLY is written in the machine's byte order");

/// Layout of a file's vertices and faces.
struct PlyLayout {
  bool doubles = false, normals = false, colors = false;
  const std::vector<std::string>& comments;

  std::size_t vertex_size() const {
    return 3 * (doubles ? sizeof(double) : sizeof(float)) + (normals ? sizeof(Eigen::Vector3f) : 0) +
           (colors ? sizeof(Rgb) : 0);
  }
  void put_vertex(const PointCloud& cloud, std::size_t i, RecordEncoder& encoder) const {
    for (const double x : cloud.points[i]) doubles ? encoder.put(x) : encoder.put(static_cast<float>(x));
    if (normals) encoder.put(cloud.normals[i]);
    if (colors) encoder.put(cloud.colors[i]);
  }
  static constexpr std::size_t face_size = 1 + sizeof(Triangles::value_type);
  static void put_face(const Triangles::value_type& triangle, RecordEncoder& encoder) {
    encoder.put(std::uint8_t{3});
    encoder.put(triangle);
  }
  std::string header(std::size_t vertices, std::size_t faces) const {
    const std::string coordinate = doubles ? "property double " : "property float ";
    std::string header = "ply\nformat binary_little_endian 1.0\n";
    for (const std::string& comment : comments) header += "comment " + comment + "\n";
    header += "element vertex " + std::to_string(vertices) + "\n";
    for (const char* name : {"x", "y", "z"}) header += coordinate + name + "\n";
    if (normals) header += "property float nx\nproperty float ny\nproperty float nz\n";
    if (colors) header += "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    header += "element face " + std::to_string(faces) + "\nproperty list uchar int vertex_indices\n";
    return header + "end_header\n";
  }
};

/// Whether rounding to float could move a vertex by more than a thousandth of the mean spacing.
bool needs_double(const Eigen::AlignedBox3d& box, std::size_t count) {
  if (count == 0) return false;
  constexpr double float_rounding = 1.0 / (1 << 24);
  const double largest = std::max(box.min().cwiseAbs().maxCoeff(), box.max().cwiseAbs().maxCoeff());
  const double spacing = box.diagonal().norm() / std::sqrt(static_cast<double>(count));
  return largest * float_rounding > 1e-3 * spacing;
}

/// Throws for formats that only the Python package reads.
void require_no_scan(const std::filesystem::path& path, const InputFile& file) {
  const std::string suffix = in_lower_case(path.extension().string());
  if (suffix == ".las" || suffix == ".laz" || suffix == ".e57")
    throw file.error("is LAS or E57, which only the Python package reads (malus run); expected PLY or text");
}

}  // namespace

PointCloud read_point_cloud(const std::filesystem::path& path, const Context& context, const std::string& what) {
  InputFile file(path, what);
  require_no_scan(path, file);
  if (is_ply(file)) return read_ply(file, PlyParts::vertices, context).vertices;
  require_text(file);
  return read_xyz(file, context);
}

TriangleMesh read_mesh(const std::filesystem::path& path, const Context& context) {
  InputFile file(path, "mesh");
  if (!is_ply(file)) throw file.error("is not a PLY file, expected one; convert other meshes, such as OBJ and STL");
  TriangleMesh mesh = read_ply(file, PlyParts::vertices_and_faces, context);
  if (mesh.triangles.empty()) throw file.error("has no faces, expected some; points alone are a cloud");
  return mesh;
}

TriangleMesh read_cloud_or_mesh(const std::filesystem::path& path, const Context& context) {
  InputFile file(path, "reference");
  require_no_scan(path, file);
  if (is_ply(file)) return read_ply(file, PlyParts::vertices_and_faces, context);
  require_text(file);
  return {read_xyz(file, context), {}};
}

void write_ply(const std::filesystem::path& path, const TriangleMesh& mesh, const Context& context,
               const std::vector<std::string>& comments) {
  const PointCloud& cloud = mesh.vertices;
  const std::size_t count = cloud.points.size();
  if ((!cloud.normals.empty() && cloud.normals.size() != count) ||
      (!cloud.colors.empty() && cloud.colors.size() != count)) {
    throw input_error("cannot write " + path.string() + ": " + std::to_string(count) + " points with " +
                      std::to_string(cloud.normals.size()) + " normals and " + std::to_string(cloud.colors.size()) +
                      " colors, expected none or as many");
  }
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& point : cloud.points) box.extend(point);
  const PlyLayout layout{needs_double(box, count), !cloud.normals.empty(), !cloud.colors.empty(), comments};
  AtomicFile file(path);
  const std::string header = layout.header(count, mesh.triangles.size());
  file.write(header);
  const std::size_t first_face = header.size() + count * layout.vertex_size();
  file.expect(first_face + mesh.triangles.size() * PlyLayout::face_size);
  write_records(file, header.size(), count, layout.vertex_size(), context,
                [&](std::size_t i, RecordEncoder& encoder) { layout.put_vertex(cloud, i, encoder); });
  write_records(file, first_face, mesh.triangles.size(), PlyLayout::face_size, context,
                [&](std::size_t i, RecordEncoder& encoder) { PlyLayout::put_face(mesh.triangles[i], encoder); });
  file.commit();
}

void write_ply(const std::filesystem::path& path, const MeshInStrips& mesh, const Context& context,
               const std::vector<std::string>& comments) {
  const PlyLayout layout{needs_double(mesh.box, mesh.vertices), true, mesh.has_colors, comments};
  AtomicFile file(path);
  const std::string header = layout.header(mesh.vertices, mesh.triangles);
  file.write(header);
  const std::size_t first_face = header.size() + mesh.vertices * layout.vertex_size();
  file.expect(first_face + mesh.triangles * PlyLayout::face_size);
  parallel_for(context, mesh.strips, 1, [&](std::size_t k, std::size_t) {
    MeshStrip strip = mesh.strip(k, MeshInStrips::Parts::all);
    FileBlock vertices(header.size() + strip.first_vertex * layout.vertex_size(),
                       strip.vertices * layout.vertex_size());
    RecordEncoder to_vertices = vertices.encoder();
    for (std::size_t i = 0; i < strip.vertices; ++i) layout.put_vertex(strip.mesh.vertices, i, to_vertices);
    vertices.write_to(file);

    FileBlock faces(first_face + strip.first_triangle * PlyLayout::face_size,
                    strip.mesh.triangles.size() * PlyLayout::face_size);
    RecordEncoder to_faces = faces.encoder();
    const auto first = static_cast<std::uint32_t>(strip.first_vertex);
    for (const auto& [a, b, c] : strip.mesh.triangles) PlyLayout::put_face({a + first, b + first, c + first}, to_faces);
    faces.write_to(file);
  });
  file.commit();
}

}  // namespace malus
