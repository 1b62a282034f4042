#include <algorithm>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "malus/io/cloud_builder_internal.h"
#include "malus/io/point_columns_internal.h"
#include "malus/io/xyz_reader_internal.h"

namespace malus {
namespace {

bool is_comment_of_text(std::string_view line) {
  return is_comment(line, {"#", "%", "//"});
}

/// Slot of a column's name, which may be in quotes, or slot_count.
std::size_t slot_of_column(std::string_view name) {
  if (name.size() > 2 && name.front() == '"' && name.back() == '"') name = name.substr(1, name.size() - 2);
  return slot_of(std::string(name));
}

/// Columns by the names of a header line, if it names x, y and z. In a comment one of the known names must come
/// first, because any text can have x, y and z somewhere.
std::optional<PointColumns> columns_of_names(std::string_view line, std::vector<std::string_view>& words) {
  const bool comment = is_comment_of_text(line);
  line.remove_prefix(std::min(line.find_first_not_of("#/% \t"), line.size()));
  split_words(line, words);
  if (words.empty() || (comment && slot_of_column(words[0]) == slot_count)) return std::nullopt;
  PointColumns columns;
  for (std::size_t i = 0; i < words.size(); ++i) {
    const std::size_t slot = slot_of_column(words[i]);
    if (slot != slot_count && !columns.column[slot]) columns.column[slot] = i;
  }
  return columns.has_three(slot_x) ? std::optional(columns) : std::nullopt;
}

/// Meaning of columns without names; all lines together show which of them are normals instead
/// (CloudBuilder::finish).
PointColumns columns_of_count(std::size_t count) {
  PointColumns columns;
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

}  // namespace

PointCloud read_xyz(InputFile& file, const Context& context) {
  std::optional<PointColumns> columns;
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

}  // namespace malus
