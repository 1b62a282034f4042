// jpeglib.h needs FILE declared before it.
// clang-format off
#include <cstdio>
#include <jpeglib.h>
#include <jerror.h>
// clang-format on

#include <csetjmp>
#include <cstdlib>
#include <stdexcept>
#include <vector>

#include "malus/io/image_codecs_internal.h"

namespace malus::codecs {
namespace {

// A block of 8 x 8 pixels takes at least one bit.
constexpr double most_pixels_per_byte = 512;

// As with PNG, the functions that call setjmp own nothing that needs a destructor.
struct JpegErrors {
  jpeg_error_mgr errors{};
  std::jmp_buf jump{};
  char message[JMSG_LENGTH_MAX] = {};
};

struct JpegReader : JpegErrors {
  jpeg_decompress_struct jpeg{};
  std::string_view bytes;
  bool created = false;

  ~JpegReader() {
    if (created) jpeg_destroy_decompress(&jpeg);
  }
};

void fail(j_common_ptr jpeg) {
  auto& codec = *static_cast<JpegErrors*>(jpeg->client_data);
  jpeg->err->format_message(jpeg, codec.message);
  std::longjmp(codec.jump, 1);
}

// libjpeg only warns when data end early or make no sense, and fills the rest of the image with gray: unusable for
// measurements.
void fail_on_warning(j_common_ptr jpeg, int level) {
  const int code = jpeg->err->msg_code;
  const bool harmless = code == JWRN_EXTRANEOUS_DATA || code == JWRN_JFIF_MAJOR || code == JWRN_ADOBE_XFORM;
  if (level < 0 && !harmless) fail(jpeg);
}

void print_nothing(j_common_ptr) {}

/// Lets libjpeg report errors to the reader or writer itself.
template <class Codec>
void catch_errors(Codec& codec) {
  codec.jpeg.err = jpeg_std_error(&codec.errors);
  codec.errors.error_exit = fail;
  codec.errors.output_message = print_nothing;
  codec.jpeg.client_data = static_cast<JpegErrors*>(&codec);
}

bool read_jpeg_header(JpegReader& reader) {
  if (setjmp(reader.jump)) return false;
  jpeg_create_decompress(&reader.jpeg);
  reader.created = true;
  jpeg_mem_src(&reader.jpeg, reinterpret_cast<const unsigned char*>(reader.bytes.data()), reader.bytes.size());
  jpeg_read_header(&reader.jpeg, TRUE);
  const bool gray = reader.jpeg.num_components == 1;
  reader.jpeg.out_color_space = gray ? JCS_GRAYSCALE : JCS_RGB;
  reader.jpeg.dct_method = JDCT_ISLOW;
  jpeg_calc_output_dimensions(&reader.jpeg);
  return true;
}

bool read_jpeg_rows(JpegReader& reader, JSAMPLE* row, Image<float>& pixels) {
  if (setjmp(reader.jump)) return false;
  jpeg_start_decompress(&reader.jpeg);
  const std::size_t row_samples =
      static_cast<std::size_t>(pixels.width()) * static_cast<std::size_t>(pixels.channels());
  while (reader.jpeg.output_scanline < reader.jpeg.output_height) {
    float* target = pixels.row(static_cast<int>(reader.jpeg.output_scanline));
    jpeg_read_scanlines(&reader.jpeg, &row, 1);
    for (std::size_t i = 0; i < row_samples; ++i) target[i] = static_cast<float>(row[i]);
  }
  jpeg_finish_decompress(&reader.jpeg);
  return true;
}

struct JpegWriter : JpegErrors {
  jpeg_compress_struct jpeg{};
  unsigned char* bytes = nullptr;
  unsigned long size = 0;
  bool created = false;

  ~JpegWriter() {
    if (created) jpeg_destroy_compress(&jpeg);
    std::free(bytes);
  }
};

bool write_jpeg_rows(JpegWriter& writer, const Image<std::uint8_t>& image, int quality) {
  if (setjmp(writer.jump)) return false;
  jpeg_create_compress(&writer.jpeg);
  writer.created = true;
  jpeg_mem_dest(&writer.jpeg, &writer.bytes, &writer.size);
  writer.jpeg.image_width = static_cast<JDIMENSION>(image.width());
  writer.jpeg.image_height = static_cast<JDIMENSION>(image.height());
  writer.jpeg.input_components = image.channels();
  writer.jpeg.in_color_space = image.channels() == 1 ? JCS_GRAYSCALE : JCS_RGB;
  jpeg_set_defaults(&writer.jpeg);
  jpeg_set_quality(&writer.jpeg, quality, TRUE);
  jpeg_start_compress(&writer.jpeg, TRUE);
  for (int v = 0; v < image.height(); ++v) {
    // libjpeg's interface is not const-correct; it only reads.
    JSAMPLE* row = const_cast<JSAMPLE*>(image.row(v));
    jpeg_write_scanlines(&writer.jpeg, &row, 1);
  }
  jpeg_finish_compress(&writer.jpeg);
  return true;
}

}  // namespace

RawImage decode_jpeg(std::string_view bytes, const HeaderCheck& check) {
  JpegReader reader;
  reader.bytes = bytes;
  catch_errors(reader);
  reader.errors.emit_message = fail_on_warning;
  if (!read_jpeg_header(reader)) throw std::runtime_error(reader.message);
  if (reader.jpeg.num_components != 1 && reader.jpeg.num_components != 3) {
    throw std::runtime_error("has " + std::to_string(reader.jpeg.num_components) + " components, expected gray or RGB");
  }
  const ImageHeader header{{static_cast<int>(reader.jpeg.output_width), static_cast<int>(reader.jpeg.output_height)},
                           reader.jpeg.num_components,
                           most_pixels_per_byte * static_cast<double>(bytes.size())};
  check(header);
  RawImage image{Image<float>(header.size, header.channels), 8};
  std::vector<JSAMPLE> row(static_cast<std::size_t>(header.size.width) * static_cast<std::size_t>(header.channels));
  if (!read_jpeg_rows(reader, row.data(), image.pixels)) throw std::runtime_error(reader.message);
  return image;
}

std::string encode_jpeg(const Image<std::uint8_t>& image, int quality) {
  JpegWriter writer;
  catch_errors(writer);
  if (!write_jpeg_rows(writer, image, quality))
    throw resource_error("cannot encode a JPEG: " + std::string(writer.message));
  return {reinterpret_cast<const char*>(writer.bytes), writer.size};
}

}  // namespace malus::codecs
