#include <algorithm>
#include <cmath>
#include <set>
#include <stdexcept>
#include <string_view>

#include "malus/io/atomic_file_internal.h"
#include "malus/io/image_codecs_internal.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/input_file_internal.h"

namespace malus {
namespace {

using namespace std::string_view_literals;

constexpr int longest_side = 65536;
constexpr double most_pixels = 1 << 29;

std::string name_of(const std::string& what, const std::filesystem::path& path) {
  return what + " " + path.string();
}

/// Checks the size that a header claims, before memory is allocated for it.
void check_header(const codecs::ImageHeader& header, const std::string& name) {
  const Size size = header.size;
  const auto pixels = static_cast<double>(size.area());
  if (size.width < 1 || size.height < 1 || size.width > longest_side || size.height > longest_side ||
      pixels > most_pixels) {
    throw input_error(name + " claims " + to_string(size) + " pixels, expected at most 65536 a side and 2^29 in all");
  }
  if (pixels > header.most_pixels) {
    throw input_error(name + " claims " + to_string(size) +
                      " pixels, more than its bytes can hold: truncated or damaged");
  }
}

RawImage decode(const std::filesystem::path& path, const std::string& what, const std::string& name,
                codecs::Alpha alpha, const codecs::HeaderCheck& check) {
  const auto file = read_bytes(path, what);
  const std::string_view bytes(file.data(), file.size());
  try {
    if (bytes.starts_with("\x89PNG\r\n\x1a\n"sv)) return codecs::decode_png(bytes, alpha, check);
    if (bytes.starts_with("\xff\xd8\xff"sv)) return codecs::decode_jpeg(bytes, check);
    for (const std::string_view magic : {"II*\0"sv, "MM\0*"sv, "II+\0"sv, "MM\0+"sv})
      if (bytes.starts_with(magic)) return codecs::decode_tiff(bytes, alpha, check);
  } catch (const Error&) {
    throw;
  } catch (const std::runtime_error& error) {
    throw input_error(name + ": truncated, damaged or unsupported (" + error.what() + ")");
  }
  throw input_error(name + " is none of the images that can be read, expected PNG, TIFF or JPEG");
}

/// Calls encode(file, image), which writes the file's bytes.
template <class Sample, class Encode>
void write_image(const std::filesystem::path& path, const Image<Sample>& image, Encode&& encode) {
  const Size size = image.size();
  const int channels = image.channels();
  if (size.width < 1 || size.height < 1 || (channels != 1 && channels != 3)) {
    throw input_error("cannot write " + path.string() + ": " + to_string(size) + " pixels with " +
                      std::to_string(channels) + " channels, expected at least one pixel and 1 or 3 channels");
  }
  AtomicFile file(path);
  encode(file, image);
  file.commit();
}

template <class Sample>
void write_png_samples(AtomicFile& file, const Image<Sample>& image) {
  codecs::encode_png(file, image.data(), image.size(), image.channels(), 8 * static_cast<int>(sizeof(Sample)));
}

void refuse_raw(const std::filesystem::path& path, const std::string& name) {
  if (!is_raw_name(path)) return;
  throw input_error(name +
                    " is a camera's RAW file: the Python program `malus` develops it (pip install 'malus[raw]'), "
                    "this one expects linear PNG or TIFF");
}

RawImage read_pixels(const std::filesystem::path& path, const std::string& what, codecs::Alpha alpha) {
  const std::string name = name_of(what, path);
  refuse_raw(path, name);
  return decode(path, what, name, alpha, [&](const codecs::ImageHeader& header) { check_header(header, name); });
}

/// The brightest color of each pixel, no brighter than the pixel is opaque. NaN, with which floating-point rasters mark
/// pixels without data, is black.
Image<float> brightest_over_black(const Image<float>& pixels) {
  const int channels = pixels.channels(), colors = channels % 2 != 0 ? channels : channels - 1;
  auto brightest = Image<float>::uninitialized(pixels.size());
  const float* from = pixels.data();
  for (float& value : brightest) {
    value = 0;
    for (int c = 0; c < colors; ++c) {
      if (std::abs(from[c]) > std::abs(value)) value = from[c];
    }
    if (colors < channels) value = std::min(value, from[colors]);
    from += channels;
  }
  return brightest;
}

/// Makes NaN of the value that GDAL's nodata tag names; `text`: the tag's.
void clear_no_data(Image<float>& pixels, std::string_view text, const std::string& name) {
  const auto is_printable = [](unsigned char c) { return c >= ' ' && c <= '~'; };
  text.remove_prefix(std::min(text.find_first_not_of(' '), text.size()));
  text = text.substr(0, text.find_last_not_of(' ') + 1);
  double number = 0;
  if (!parse_number(text, number)) {
    const bool is_shown = !text.empty() && text.size() <= 60 && std::ranges::all_of(text, is_printable);
    throw input_error(name + " has a GDAL nodata tag (42113)" +
                      (is_shown ? " = \"" + std::string(text) + "\"" : " that is damaged") +
                      ", expected the number that stands for pixels without a value; set it anew, or remove the tag");
  }
  // Samples of 64 bits were rounded in the same way.
  const auto hole = static_cast<float>(number);
  std::ranges::replace(pixels, hole, no_value);
}

}  // namespace

RawImage read_image(const std::filesystem::path& path, const std::string& what) {
  return read_pixels(path, what, codecs::Alpha::dropped);
}

Image<float> read_intensity(const std::filesystem::path& path) {
  RawImage image = read_image(path, "photo");
  const int channels = image.pixels.channels();
  const auto full_scale = static_cast<float>(image.full_scale_dn());
  if (channels == 1) {
    for (float& value : image.pixels) value /= full_scale;
    return std::move(image.pixels);
  }
  Image<float> mean = Image<float>::uninitialized(image.pixels.size());
  const float* pixel = image.pixels.data();
  for (float& value : mean) {
    float sum = 0;
    for (int c = 0; c < channels; ++c) sum += *pixel++;
    value = sum / static_cast<float>(channels) / full_scale;
  }
  return mean;
}

Size read_image_size(const std::filesystem::path& path, const std::string& what) {
  struct Found {
    Size size;
  };
  const std::string name = name_of(what, path);
  refuse_raw(path, name);
  try {
    // The header check runs before any pixel is decoded; throwing from it skips the decoding.
    decode(path, what, name, codecs::Alpha::dropped, [&](const codecs::ImageHeader& header) {
      check_header(header, name);
      throw Found{header.size};
    });
  } catch (const Found& found) {
    return found.size;
  }
  throw std::logic_error("the header check was not called");
}

Mask read_mask(const std::filesystem::path& path) {
  const Image<float> pixels = brightest_over_black(read_pixels(path, "mask", codecs::Alpha::kept).pixels);
  // Photographs have more gray than the soft edges of a drawn mask, and more values than label images. After JPEG
  // compression, black and white change by less than a tenth of the range.
  constexpr double largest_gray_share = 0.05, black_below = 0.1, white_above = 0.9;
  constexpr std::size_t few_values = 16;
  const float largest = *std::ranges::max_element(pixels);
  if (!(largest > 0))
    throw input_error(name_of("mask", path) + " is black everywhere, expected white where the object is");
  std::size_t gray = 0;
  std::set<float> values;
  for (const float value : pixels) {
    if (values.size() <= few_values) values.insert(value);
    gray += value > black_below * largest && value < white_above * largest;
  }
  const double gray_share = static_cast<double>(gray) / static_cast<double>(pixels.count());
  const bool has_soft_edges = values.size() > few_values;
  if (gray_share > largest_gray_share && has_soft_edges) {
    throw input_error(name_of("mask", path) +
                      " looks like a photograph: " + std::to_string(std::lround(100 * gray_share)) +
                      " % of its pixels are neither black nor white, expected black, and white where the object is");
  }
  // Around an object JPEG compression leaves pixels that are nearly black; a small number in a label image is a label.
  const float black = has_soft_edges ? static_cast<float>(black_below) * largest : 0;
  Mask mask(pixels.size());
  for (std::size_t i = 0; i < mask.count(); ++i) mask[i] = std::abs(pixels[i]) > black ? 255 : 0;
  return mask;
}

Image<std::uint8_t> read_labels(const std::filesystem::path& path) {
  const RawImage image = read_image(path, "label image");
  if (image.had_palette) {
    // The places in the table are no labels: programs order the colors as they like.
    throw input_error(
        name_of("label image", path) +
        " has a palette: its pixels are colors of a table, expected 0 (decide), 1 (diffuse) and 2 (specular) as gray "
        "values; save these numbers as gray, not as indexed color, with 8 bits");
  }
  if (image.pixels.channels() != 1 || image.bits != 8) {
    throw input_error(name_of("label image", path) + " has " + std::to_string(image.pixels.channels()) +
                      " channels of " + std::to_string(image.bits) + " bits, expected 1 channel of at most 8 bits");
  }
  Image<std::uint8_t> labels(image.pixels.size());
  std::transform(image.pixels.begin(), image.pixels.end(), labels.begin(),
                 [&](float value) { return static_cast<std::uint8_t>(static_cast<int>(value) / image.scale); });
  return labels;
}

Image<float> read_float_raster(const std::filesystem::path& path, const std::string& what) {
  RawImage image = read_image(path, what);
  if (!image.is_float()) {
    throw input_error(name_of(what, path) + " has " + std::to_string(image.bits) +
                      "-bit integer samples, expected a floating-point TIFF");
  }
  if (image.no_data) clear_no_data(image.pixels, *image.no_data, name_of(what, path));
  return std::move(image.pixels);
}

void write_float_tiff(const std::filesystem::path& path, const Image<float>& image) {
  write_image(path, image, [](AtomicFile& file, const auto& pixels) { codecs::encode_float_tiff(file, pixels); });
}

void write_tiff16(const std::filesystem::path& path, const Image<std::uint16_t>& image) {
  write_image(path, image, codecs::encode_tiff16);
}

void write_png(const std::filesystem::path& path, const Image<std::uint8_t>& image) {
  write_image(path, image, write_png_samples<std::uint8_t>);
}

void write_png16(const std::filesystem::path& path, const Image<std::uint16_t>& image) {
  write_image(path, image, write_png_samples<std::uint16_t>);
}

}  // namespace malus
