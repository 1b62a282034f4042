#include <png.h>

#include <csetjmp>
#include <cstring>
#include <exception>
#include <stdexcept>
#include <vector>

#include "malus/io/image_codecs_internal.h"

namespace malus::codecs {
namespace {

// libpng reports errors by longjmp, which must not pass over C++ destructors. So the functions that call setjmp own
// nothing, and callbacks store C++ exceptions here instead of throwing through C frames.
struct PngCodec {
  png_structp png = nullptr;
  png_infop info = nullptr;
  std::string error;
};

struct PngReader : PngCodec {
  std::string_view bytes;
  std::size_t position = 0;
  Alpha alpha = Alpha::dropped;
  ImageHeader header;
  int bits = 8, scale = 1;
  bool had_palette = false;
  std::size_t row_bytes = 0;
  LargeVector<png_byte> samples;
  std::vector<png_bytep> rows;

  ~PngReader() { png_destroy_read_struct(&png, &info, nullptr); }
};

void on_error(png_structp png, png_const_charp message) {
  static_cast<PngCodec*>(png_get_error_ptr(png))->error = message;
  std::longjmp(png_jmpbuf(png), 1);
}

void on_warning(png_structp, png_const_charp) {}

void read_bytes(png_structp png, png_bytep target, png_size_t size) {
  auto& reader = *static_cast<PngReader*>(png_get_io_ptr(png));
  if (size > reader.bytes.size() - reader.position) png_error(png, "is truncated");
  std::memcpy(target, reader.bytes.data() + reader.position, size);
  reader.position += size;
}

bool read_png_header(PngReader& reader) {
  if (setjmp(png_jmpbuf(reader.png))) return false;
  png_set_user_limits(reader.png, 1 << 20, 1 << 20);
  png_set_read_fn(reader.png, &reader, read_bytes);
  // Keeps only the chunks needed for pixels: a few KB of compressed text would otherwise be decompressed to megabytes,
  // and kept.
  png_set_keep_unknown_chunks(reader.png, PNG_HANDLE_CHUNK_NEVER, nullptr, -1);
  // A wrong checksum means damage; for ancillary chunks the default is a warning that nobody sees.
  png_set_crc_action(reader.png, PNG_CRC_ERROR_QUIT, PNG_CRC_WARN_DISCARD);
  png_read_info(reader.png, reader.info);
  const int color = png_get_color_type(reader.png, reader.info);
  const int depth = png_get_bit_depth(reader.png, reader.info);
  reader.had_palette = color == PNG_COLOR_TYPE_PALETTE;
  if (reader.had_palette) png_set_palette_to_rgb(reader.png);
  if (color == PNG_COLOR_TYPE_GRAY && depth < 8) {
    png_set_expand_gray_1_2_4_to_8(reader.png);
    reader.scale = 255 / ((1 << depth) - 1);
  }
  if (depth == 16) png_set_swap(reader.png);
  if (reader.alpha == Alpha::dropped) {
    png_set_strip_alpha(reader.png);
  } else if (png_get_valid(reader.png, reader.info, PNG_INFO_tRNS) != 0) {
    png_set_tRNS_to_alpha(reader.png);
  }
  png_set_interlace_handling(reader.png);
  png_read_update_info(reader.png, reader.info);
  reader.header.size = {static_cast<int>(png_get_image_width(reader.png, reader.info)),
                        static_cast<int>(png_get_image_height(reader.png, reader.info))};
  reader.header.most_pixels = deflate_ratio * 8 * static_cast<double>(reader.bytes.size()) / depth;
  reader.bits = depth == 16 ? 16 : 8;
  reader.header.channels = png_get_channels(reader.png, reader.info);
  reader.row_bytes = png_get_rowbytes(reader.png, reader.info);
  return true;
}

bool read_png_rows(PngReader& reader) {
  if (setjmp(png_jmpbuf(reader.png))) return false;
  png_read_image(reader.png, reader.rows.data());
  png_read_end(reader.png, nullptr);
  return true;
}

struct PngWriter : PngCodec {
  explicit PngWriter(AtomicFile& target) : file(target) {}
  ~PngWriter() { png_destroy_write_struct(&png, &info); }

  AtomicFile& file;
  std::exception_ptr failure;
};

void write_bytes(png_structp png, png_bytep data, png_size_t size) {
  auto& writer = *static_cast<PngWriter*>(png_get_io_ptr(png));
  try {
    writer.file.write(data, size);
    return;
  } catch (...) {
    writer.failure = std::current_exception();
  }
  png_error(png, "write failed");
}

void flush_nothing(png_structp) {}

bool write_png_rows(PngWriter& writer, const png_byte* pixels, Size size, int channels, int bits) {
  if (setjmp(png_jmpbuf(writer.png))) return false;
  png_set_write_fn(writer.png, &writer, write_bytes, flush_nothing);
  png_set_compression_level(writer.png, 3);
  png_set_IHDR(writer.png, writer.info, static_cast<png_uint_32>(size.width), static_cast<png_uint_32>(size.height),
               bits, channels == 1 ? PNG_COLOR_TYPE_GRAY : PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  png_write_info(writer.png, writer.info);
  if (bits == 16) png_set_swap(writer.png);
  const std::size_t row_bytes = static_cast<std::size_t>(size.width) * static_cast<std::size_t>(channels * bits / 8);
  for (int v = 0; v < size.height; ++v) png_write_row(writer.png, pixels + static_cast<std::size_t>(v) * row_bytes);
  png_write_end(writer.png, writer.info);
  return true;
}

template <class Sample>
void to_float(const png_byte* samples, Image<float>& pixels) {
  for (std::size_t i = 0; i < pixels.count(); ++i) {
    Sample sample;
    std::memcpy(&sample, samples + i * sizeof(Sample), sizeof(Sample));
    pixels[i] = static_cast<float>(sample);
  }
}

}  // namespace

RawImage decode_png(std::string_view bytes, Alpha alpha, const HeaderCheck& check) {
  PngReader reader;
  reader.bytes = bytes;
  reader.alpha = alpha;
  reader.png = png_create_read_struct(PNG_LIBPNG_VER_STRING, static_cast<PngCodec*>(&reader), on_error, on_warning);
  if (reader.png) reader.info = png_create_info_struct(reader.png);
  if (!reader.info) throw std::bad_alloc();
  if (!read_png_header(reader)) throw std::runtime_error(reader.error);
  check(reader.header);

  const auto height = static_cast<std::size_t>(reader.header.size.height);
  reader.samples.resize(reader.row_bytes * height);
  reader.rows.resize(height);
  for (std::size_t v = 0; v < height; ++v) reader.rows[v] = reader.samples.data() + v * reader.row_bytes;
  if (!read_png_rows(reader)) throw std::runtime_error(reader.error);

  RawImage image{Image<float>::uninitialized(reader.header.size, reader.header.channels), reader.bits};
  image.scale = reader.scale;
  image.had_palette = reader.had_palette;
  if (reader.bits == 16) {
    to_float<png_uint_16>(reader.samples.data(), image.pixels);
  } else {
    to_float<png_byte>(reader.samples.data(), image.pixels);
  }
  return image;
}

void encode_png(AtomicFile& file, const void* pixels, Size size, int channels, int bits) {
  PngWriter writer(file);
  writer.png = png_create_write_struct(PNG_LIBPNG_VER_STRING, static_cast<PngCodec*>(&writer), on_error, on_warning);
  if (writer.png) writer.info = png_create_info_struct(writer.png);
  if (!writer.info) throw std::bad_alloc();
  if (write_png_rows(writer, static_cast<const png_byte*>(pixels), size, channels, bits)) return;
  if (writer.failure) std::rethrow_exception(writer.failure);
  throw resource_error("cannot write " + file.path().string() + ": " + writer.error);
}

}  // namespace malus::codecs
