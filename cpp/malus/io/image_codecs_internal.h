#pragma once

// Private to the io room: one decoder per format; each takes the bytes of a whole file.

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>

#include "malus/core/image.h"
#include "malus/io/atomic_file_internal.h"
#include "malus/io/image_file_internal.h"

struct tiff;  // libtiff's TIFF

namespace malus::codecs {

/// Content of an image file's header.
struct ImageHeader {
  Size size;
  int channels = 1;        ///< of the result: 1 or 3, and one more for alpha that is kept
  double most_pixels = 0;  ///< largest number that a file of this length and compression can hold
};

/// What a decoder does with an alpha channel: none in the result, or the last one of the result, if the file has one.
enum class Alpha { dropped, kept };

/// TIFF tag of GDAL: the value that stands for "no data", a number as text.
inline constexpr std::uint32_t gdal_nodata_tag = 42113;

/// Called with the header before pixels are decoded; throws when the pixels are not wanted or cannot be in the file.
using HeaderCheck = std::function<void(const ImageHeader&)>;

/// Largest number of bytes that one byte of a Deflate stream can expand to.
inline constexpr double deflate_ratio = 1032;

/// Throws std::runtime_error with the reason on files that are damaged or of an unsupported kind; the caller adds the
/// path.
RawImage decode_png(std::string_view bytes, Alpha alpha, const HeaderCheck& check);
RawImage decode_jpeg(std::string_view bytes, const HeaderCheck& check);
RawImage decode_tiff(std::string_view bytes, Alpha alpha, const HeaderCheck& check);

void encode_png(AtomicFile& file, const void* pixels, Size size, int channels, int bits);
/// JPEG file of an 8-bit image of 1 or 3 channels; quality 1 … 100.
std::string encode_jpeg(const Image<std::uint8_t>& image, int quality);
/// `add_tags` may set further fields before the pixels are written; null = none.
void encode_float_tiff(AtomicFile& file, const Image<float>& image, const std::function<void(tiff*)>& add_tags = {});
void encode_tiff16(AtomicFile& file, const Image<std::uint16_t>& image);

}  // namespace malus::codecs
