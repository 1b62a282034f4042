// jpeglib.h needs FILE declared before it.
// clang-format off
#include <cstdio>
#include <jpeglib.h>
#include <jerror.h>
// clang-format on

#include <csetjmp>
#include <stdexcept>
#include <vector>

#include "malus/io/image_codecs_internal.h"

namespace malus::codecs {
namespace {

// A block of 8 x 8 pixels takes at least one bit.
constexpr double most_pixels_per_byte = 512;

// As with PNG, the functions that call setjmp own nothing that needs a destructor.
struct Reader {
  jpeg_decompress_struct jpeg{};
  jpeg_error_mgr errors{};
  std::jmp_buf jump{};
  char message[JMSG_LENGTH_MAX] = {};
  std::string_view bytes;
  bool created = false;

  ~Reader() {
    if (created) jpeg_destroy_decompress(&jpeg);
  }
};

void fail(j_common_ptr jpeg) {
  auto& reader = *static_cast<Reader*>(jpeg->client_data);
  jpeg->err->format_message(jpeg, reader.message);
  std::longjmp(reader.jump, 1);
}

// libjpeg only warns when data end early or make no sense, and fills the rest with grey: not for measurements.
void fail_on_warning(j_common_ptr jpeg, int level) {
  const int code = jpeg->err->msg_code;
  const bool harmless = code == JWRN_EXTRANEOUS_DATA || code == JWRN_JFIF_MAJOR || code == JWRN_ADOBE_XFORM;
  if (level < 0 && !harmless) fail(jpeg);
}

void print_nothing(j_common_ptr) {}

bool read_header(Reader& reader) {
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

bool read_rows(Reader& reader, JSAMPLE* row, Image<float>& pixels) {
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

}  // namespace

RawImage decode_jpeg(std::string_view bytes, const HeaderCheck& check) {
  Reader reader;
  reader.bytes = bytes;
  reader.jpeg.err = jpeg_std_error(&reader.errors);
  reader.errors.error_exit = fail;
  reader.errors.emit_message = fail_on_warning;
  reader.errors.output_message = print_nothing;
  reader.jpeg.client_data = &reader;
  if (!read_header(reader)) throw std::runtime_error(reader.message);
  if (reader.jpeg.num_components != 1 && reader.jpeg.num_components != 3) {
    throw std::runtime_error("has " + std::to_string(reader.jpeg.num_components) + " components, expected grey or RGB");
  }
  const ImageHeader header{{static_cast<int>(reader.jpeg.output_width), static_cast<int>(reader.jpeg.output_height)},
                           reader.jpeg.num_components,
                           most_pixels_per_byte * static_cast<double>(bytes.size())};
  check(header);
  RawImage image{Image<float>(header.size, header.channels), 8, false, 255.0};
  std::vector<JSAMPLE> row(static_cast<std::size_t>(header.size.width) * static_cast<std::size_t>(header.channels));
  if (!read_rows(reader, row.data(), image.pixels)) throw std::runtime_error(reader.message);
  return image;
}

}  // namespace malus::codecs
