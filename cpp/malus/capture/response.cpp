#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <optional>
#include <sstream>

#include "malus/capture/response_internal.h"
#include "malus/core/digits_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/io/input_file_internal.h"

namespace malus {
namespace {

constexpr std::size_t max_table_bytes = 4u << 20;
constexpr std::size_t max_table_rows = 65536;
/// Number of clipped samples that do not come by chance.
constexpr std::ptrdiff_t fewest_clipped = 10;

double srgb_to_linear(double x) {
  return x <= 0.04045 ? x / 12.92 : std::pow((x + 0.055) / 1.055, 2.4);
}

double interpolate(const std::vector<double>& x, const std::vector<double>& y, double at) {
  if (at <= x.front()) return y.front();
  if (!(at < x.back())) return std::isnan(at) ? at : y.back();
  const auto i = static_cast<std::size_t>(std::upper_bound(x.begin(), x.end(), at) - x.begin());
  return y[i - 1] + (y[i] - y[i - 1]) * (at - x[i - 1]) / (x[i] - x[i - 1]);
}

/// Numbers of one line of a table; nothing if a word is not a finite number.
std::optional<std::vector<double>> numbers_of(std::string_view line) {
  std::vector<std::string_view> words;
  split_words(line.substr(0, line.find('#')), words);
  std::vector<double> numbers;
  for (const std::string_view word : words) {
    const auto number = number_of<double>(word);
    if (!number || !std::isfinite(*number)) return std::nullopt;
    numbers.push_back(*number);
  }
  return numbers;
}

void check_table(ResponseCurve& curve, const std::string& name) {
  if (curve.linear.size() < 2) throw input_error(name + ": a response table needs at least 2 rows");
  for (std::size_t i = 1; i < curve.linear.size(); ++i) {
    if (!(curve.encoded[i] > curve.encoded[i - 1])) {
      throw input_error(name + ": row " + std::to_string(i + 1) + ": encoded values must increase from row to row");
    }
    if (curve.linear[i] < curve.linear[i - 1]) {
      throw input_error(name + ": row " + std::to_string(i + 1) + ": linear values must not decrease");
    }
  }
  if (!(curve.linear.back() > 0) || curve.linear.front() < 0) {
    throw input_error(name + ": linear values must not be negative, and the last one must be positive");
  }
  const double white = curve.linear.back();
  for (double& value : curve.linear) value /= white;
}

/// Encoded → linear for every pixel of a raster; tables in DN are looked up before the levels are applied.
class Linearizer {
 public:
  Linearizer(const RawImage& raw, const ResponseCurve& curve, const Levels& levels) : curve_(curve), levels_(levels) {
    if (raw.is_float() || curve.is_identity()) return;
    // Table of the curve for every number that the file can hold.
    for (int dn = 0; dn < 1 << raw.bits; ++dn) of_number_.push_back(through_curve(dn));
  }
  double encoded(double dn) const { return (dn - levels_.black_dn) / (levels_.white_dn - levels_.black_dn); }
  double linear(double dn) const {
    if (!(dn >= 0 && dn < static_cast<double>(of_number_.size()))) return through_curve(dn);
    return of_number_[static_cast<std::size_t>(dn)];
  }
  bool saturated(double dn) const { return encoded(dn) >= levels_.saturation; }

  /// Replaces a row of gray values by linear intensities; returns whether all are finite.
  bool linearize_row(float* values, int count, std::uint8_t* saturated) const {
    // Local copies cannot alias the bytes written, so the compiler can vectorize these loops.
    const double black = levels_.black_dn, range = levels_.white_dn - black, saturation = levels_.saturation;
    for (int i = 0; i < count; ++i) saturated[i] = (values[i] - black) / range >= saturation ? 255 : 0;
    if (curve_.is_identity()) {
      for (int i = 0; i < count; ++i) values[i] = static_cast<float>((values[i] - black) / range);
    } else {
      for (int i = 0; i < count; ++i) values[i] = static_cast<float>(linear(values[i]));
    }
    int bad = 0;
    for (int i = 0; i < count; ++i) bad |= !(std::abs(values[i]) <= std::numeric_limits<float>::max());
    return bad == 0;
  }

 private:
  double through_curve(double dn) const { return curve_.linearize(curve_.is_of_numbers() ? dn : encoded(dn)); }

  const ResponseCurve& curve_;
  const Levels& levels_;
  std::vector<double> of_number_;  ///< linear intensity of each digital number; empty = evaluate the curve
};

/// Whether the image has three channels that differ somewhere.
bool is_color(const RawImage& raw) {
  if (raw.pixels.channels() != 3) return false;
  const float* p = raw.pixels.data();
  for (std::size_t i = 0; i < raw.pixels.count(); i += 3) {
    if (p[i] != p[i + 1] || p[i] != p[i + 2]) return true;
  }
  return false;
}

Error not_finite(const std::string& name, int u, int v) {
  return input_error(name + ": pixel (" + std::to_string(u) + ", " + std::to_string(v) + ") is not a finite number");
}

/// Whether far more samples have the image's largest number than any of the numbers just below it, as where a sensor
/// clips. Some must lie below it: an even background has its largest number everywhere, too.
bool is_clipped_at(const RawImage& raw, float largest) {
  constexpr double just_below = 0.02, peak = 10, float_steps = 65535;
  const auto least = static_cast<float>((1 - just_below) * largest);
  std::ptrdiff_t clipped = 0, below = 0;
  for (const float value : raw.pixels) {
    clipped += value == largest;
    below += value >= least && value < largest;
  }
  const double steps = just_below * (raw.is_float() ? float_steps : static_cast<double>(largest));
  return clipped >= fewest_clipped && below >= fewest_clipped &&
         static_cast<double>(clipped) > peak * std::max(static_cast<double>(below) / std::max(steps, 1.0), 1.0);
}

}  // namespace

double ResponseCurve::linearize(double value) const {
  if (is_identity()) return value;
  if (kind == Kind::table) return interpolate(encoded, linear, value);
  const double clipped = std::max(value, 0.0);
  return kind == Kind::srgb ? srgb_to_linear(clipped) : std::pow(clipped, exponent);
}

double ResponseCurve::slope(double value) const {
  const double scale = kind == Kind::table ? std::max(1.0, encoded.back()) : 1.0, half = 0.5 / 255;
  const double low = std::max(value - half, 0.0), high = std::min(value + half, 1.0);
  return (linearize(high * scale) - linearize(low * scale)) / (high - low);
}

ResponseCurve response_curve(const Response& response, const std::string& where) {
  const std::optional<std::filesystem::path> table = response.table();
  if (!table) return {.kind = response.kind(), .exponent = response.exponent(), .encoded = {}, .linear = {}};
  if (!std::filesystem::is_regular_file(*table)) {
    throw input_error(where + " = \"" + response.text() +
                      "\", expected \"linear\", \"srgb\", \"gamma:X\" or the path of a lookup table that exists");
  }
  return read_response_table(*table);
}

ResponseCurve read_response_table(const std::filesystem::path& path) {
  const std::string name = path.string();
  InputFile file(path, "response table");
  if (file.size() > max_table_bytes) throw input_error(name + ": a response table has at most 4 MB");

  ResponseCurve curve{.kind = ResponseCurve::Kind::table, .encoded = {}, .linear = {}};
  std::size_t columns = 0;
  for (std::string_view line; file.read_line(line);) {
    const auto numbers = numbers_of(line);
    const std::string where = name + ": line " + std::to_string(file.line_number());
    if (!numbers || numbers->size() > 2) throw input_error(where + ": expected one or two finite numbers");
    if (numbers->empty()) continue;
    if (columns != 0 && numbers->size() != columns) throw input_error(where + ": rows must have equally many columns");
    if (curve.linear.size() == max_table_rows) throw input_error(where + ": a response table has at most 65536 rows");
    columns = numbers->size();
    curve.linear.push_back(numbers->back());
    if (columns == 2) curve.encoded.push_back(numbers->front());
  }
  for (std::size_t i = 0; columns == 1 && i < curve.linear.size(); ++i) {
    curve.encoded.push_back(static_cast<double>(i) /
                            std::max<double>(1.0, static_cast<double>(curve.linear.size()) - 1));
  }
  check_table(curve, name);
  return curve;
}

namespace {

/// Input error for a floating-point image of digital numbers whose white level nobody states: nearly all of it would be
/// saturated at 1. Highlights of an image that was put together from several exposures may well be brighter than white.
void require_shares_of_white(const RawImage& raw, const std::string& name) {
  constexpr float too_bright = 10;
  const float largest = *std::ranges::max_element(raw.pixels);
  if (!(largest > too_bright)) return;
  const auto lit = std::ranges::count_if(raw.pixels, [](float value) { return value > 0; });
  const auto above_white = std::ranges::count_if(raw.pixels, [](float value) { return value > 1; });
  if (2 * above_white < lit) return;
  const int bits = std::bit_width(static_cast<unsigned>(std::min(largest, 65535.0F)));
  const int likely = (1 << std::max(bits, 8)) - 1;
  throw input_error(name + ": reaches " + with_digits(largest, 6) +
                    ", but white is 1 in a floating-point file; expected shares of white, or white_level = " +
                    std::to_string(likely) + " or another number that is white (1 if the file is right)");
}

}  // namespace

Levels levels_of(const RawImage& raw, const PolarizedSpec& spec, const ResponseCurve& curve, double saturation,
                 const std::string& name) {
  double white_dn = raw.full_scale_dn();
  if (curve.is_of_numbers())
    white_dn = raw.is_float() ? curve.encoded.back() : std::min(white_dn, curve.encoded.back());
  else if (raw.is_float() && !spec.white_level)
    require_shares_of_white(raw, name);
  Levels levels;
  levels.black_dn = spec.black_level;
  levels.white_dn = spec.white_level.value_or(white_dn);
  levels.saturation = saturation;
  if (!(levels.white_dn > levels.black_dn) || !std::isfinite(levels.white_dn)) {
    std::ostringstream message;
    message << name << ": white_level = " << levels.white_dn << " must be above black_level = " << levels.black_dn;
    throw input_error(message.str());
  }
  levels.dn_step = raw.is_float() ? 0.0 : 1.0 / (levels.white_dn - levels.black_dn);
  return levels;
}

void require_numbers_of_table(const RawImage& raw, const Levels& levels, const ResponseCurve& curve,
                              const std::string& name) {
  constexpr double other_scale = 2;
  if (!curve.is_of_numbers()) return;
  const double last = curve.encoded.back();
  const bool of_shares = raw.is_float() && *std::ranges::max_element(raw.pixels) <= 1;
  if (!of_shares && levels.white_dn <= other_scale * last && last <= other_scale * levels.white_dn) return;
  std::ostringstream message;
  message << name << ": the response table is of numbers up to " << last << ", but ";
  if (of_shares) {
    message << "no number of the image is above 1";
  } else {
    message << "white_level is " << levels.white_dn;
  }
  message << "; expected table, image and white_level of one scale, or a table from 0 to 1";
  throw input_error(message.str());
}

std::string doubt_of_white_level(const RawImage& raw, const Levels& levels, const std::string& name) {
  const float largest = *std::ranges::max_element(raw.pixels);
  const double range = levels.white_dn - levels.black_dn, encoded = (largest - levels.black_dn) / range;
  if (!(encoded > 0) || encoded >= levels.saturation) return {};
  const std::string same = ": many pixels have the same largest number, ",
                    clipped = ": what the sensor clipped does not count as saturated; is ";
  if (raw.is_float()) {
    if (!is_clipped_at(raw, largest)) return {};
    return name + same + with_digits(100 * encoded, 3) + " % of white" + clipped +
           "capture.saturation = " + with_digits(std::floor(1000 * encoded) / 1000, 3) + " right?";
  }
  const auto number = static_cast<unsigned>(largest);
  const std::string white = std::to_string(number), question = clipped + "white_level = " + white + " right?";
  const bool of_fewer_bits = raw.bits == 16 && (number == 1023 || number == 4095 || number == 16383);
  if (of_fewer_bits && std::ranges::count(raw.pixels, largest) >= fewest_clipped) {
    return name + ": reaches " + white + ", the largest number of " + std::to_string(std::bit_width(number)) +
           " bits, in a file of 16" + question;
  }
  return is_clipped_at(raw, largest) ? name + same + white + question : "";
}

std::array<double, 3> channel_weights(const PolarizedSpec& spec) {
  if (spec.channel_weights) {
    std::array<double, 3> weights = *spec.channel_weights;
    double sum = 0;
    for (const double weight : weights) {
      if (!(weight >= 0) || !std::isfinite(weight))
        throw input_error("channel_weights must be finite, not negative numbers");
      sum += weight;
    }
    if (!(sum > 0)) throw input_error("channel_weights are all zero");
    for (double& weight : weights) weight /= sum;
    return weights;
  }
  switch (spec.channel) {
    case ColorChannel::red:
      return {1, 0, 0};
    case ColorChannel::green:
      return {0, 1, 0};
    case ColorChannel::blue:
      return {0, 0, 1};
    case ColorChannel::mean:
      return {1.0 / 3, 1.0 / 3, 1.0 / 3};
    case ColorChannel::luminance:
      break;
  }
  return {0.2126, 0.7152, 0.0722};
}

LinearImage linearize(RawImage raw, const ResponseCurve& curve, const Levels& levels,
                      const std::array<double, 3>& weights, const std::string& name, const Context& context) {
  const int channels = raw.pixels.channels();
  if (channels != 1 && channels != 3) {
    throw input_error(name + " has " + std::to_string(channels) + " channels, expected 1 or 3");
  }
  const bool color = is_color(raw);
  const Linearizer linearizer(raw, curve, levels);
  const Size size = raw.pixels.size();
  if (channels == 1) {
    LinearImage result{std::move(raw.pixels), Mask::uninitialized(size)};
    parallel_rows(context, size.height, [&](int v) {
      float* const row = result.intensity.row(v);
      if (linearizer.linearize_row(row, size.width, result.saturated.row(v))) return;
      const auto bad = std::find_if(row, row + size.width, [](float value) { return !std::isfinite(value); });
      throw not_finite(name, static_cast<int>(bad - row), v);
    });
    return result;
  }
  LinearImage result{Image<float>::uninitialized(size), Mask::uninitialized(size), color};
  parallel_pixels(context, size, [&](int u, int v) {
    double sum = 0;
    bool saturated = false;
    for (int c = 0; c < (color ? 3 : 1); ++c) {
      const double dn = raw.pixels(u, v, c), weight = color ? weights[static_cast<std::size_t>(c)] : 1.0;
      // The object's color needs all channels.
      if (!std::isfinite(dn)) throw not_finite(name, u, v);
      if (weight == 0) continue;
      sum += weight * linearizer.linear(dn);
      saturated = saturated || linearizer.saturated(dn);
    }
    if (!std::isfinite(sum)) throw not_finite(name, u, v);
    result.intensity(u, v) = static_cast<float>(sum);
    result.saturated(u, v) = saturated ? 255 : 0;
  });
  return result;
}

Image<float> linearize_color(const RawImage& raw, const ResponseCurve& curve, const Levels& levels,
                             const std::string& name, const Context& context) {
  const Linearizer linearizer(raw, curve, levels);
  auto color = Image<float>::uninitialized(raw.pixels.size(), raw.pixels.channels());
  const int values = color.width() * color.channels();
  parallel_rows(context, color.height(), [&](int v) {
    const float* in = raw.pixels.row(v);
    float* out = color.row(v);
    for (int i = 0; i < values; ++i) {
      out[i] = static_cast<float>(linearizer.linear(in[i]));
      if (!std::isfinite(out[i])) throw not_finite(name, i / color.channels(), v);
    }
  });
  return color;
}

}  // namespace malus
