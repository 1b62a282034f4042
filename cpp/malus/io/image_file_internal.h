#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "malus/core/image.h"

namespace malus {

/// An image as stored, before any response curve.
struct RawImage {
  Image<float> pixels;  ///< digital numbers (DN); 1 channel, or 3 in the order R, G, B
  int bits = 0;         ///< of a sample: 8 or 16, or 32 or 64 in floating-point files
  /// Text of GDAL's tag for the value that stands for "no data", of a TIFF that has it; empty if it cannot be read.
  std::optional<std::string> no_data = {};
  int scale = 1;             ///< of the file's numbers: 255, 85 or 17 for a gray PNG of 1, 2 or 4 bits, which become 8
  bool had_palette = false;  ///< the file's numbers were places in a table of colors; `pixels` are the colors

  bool is_float() const { return bits > 16; }
  /// White of the format: 255 or 65535; 1 for floating-point files.
  double full_scale_dn() const { return is_float() ? 1 : (1 << bits) - 1; }
};

/// Reads PNG (1 to 16 bits; up to 8 are scaled to 8), TIFF (8 or 16 bits unsigned, 32 or 64 bits float) or JPEG (8
/// bits), gray or color. The content decides, not the file name. An alpha channel is dropped; palettes are expanded.
/// EXIF orientation is ignored: pixels keep the order in which the file stores them, the same for all files of a
/// station. `what` names the file's purpose in messages.
///
/// Throws ErrorCode::input for files that are missing, empty, truncated, damaged, not an image, of an unsupported kind,
/// or that claim a size their bytes cannot hold (checked before memory is taken).
RawImage read_image(const std::filesystem::path& path, const std::string& what = "image");

/// Intensity of a photo as encoded in its file, in [0, 1] of full scale: the mean of its channels. Errors as
/// read_image.
Image<float> read_intensity(const std::filesystem::path& path);

/// Size of an image from its header alone.
Size read_image_size(const std::filesystem::path& path, const std::string& what = "image");

/// Suffixes of image files, and of cameras' RAW files, in small letters.
inline constexpr std::array<std::string_view, 5> image_suffixes{".png", ".tif", ".tiff", ".jpg", ".jpeg"};
inline constexpr std::array<std::string_view, 15> raw_suffixes{".3fr", ".arw", ".cr2", ".cr3", ".crw",
                                                               ".dng", ".iiq", ".nef", ".nrw", ".orf",
                                                               ".pef", ".raf", ".rw2", ".sr2", ".srw"};

/// Whether the name is that of a camera's RAW file, which the Python package develops (extra `raw`); read_image and
/// read_image_size refuse such files, because their bytes may look like a preview's TIFF.
bool is_raw_name(const std::filesystem::path& path);

/// Mask from an image: 255 where any channel is neither zero nor NaN, else 0; what is transparent counts as black. In
/// an image of more than 16 values, such as a JPEG, everything up to a tenth of the largest value counts as zero.
/// Throws an input error if all pixels are zero, or if the image looks like a photograph: more than 16 values, and more
/// than 5 % of the pixels between black and white.
Mask read_mask(const std::filesystem::path& path);

/// Values of a one-channel image of up to 8 bits as the file has them (label images).
Image<std::uint8_t> read_labels(const std::filesystem::path& path);

/// Floating-point TIFF with 1 or 3 channels, values unchanged (NaN stays), but NaN for the value that GDAL's nodata tag
/// names. Errors as read_image, and ErrorCode::input when the samples are not floating-point or that tag is no number:
/// without it holes would pass for depths.
Image<float> read_float_raster(const std::filesystem::path& path, const std::string& what = "raster");

/// 32-bit float TIFF, 1 or 3 channels, uncompressed strips; BigTIFF from 4 GB. Atomic (see AtomicFile).
void write_float_tiff(const std::filesystem::path& path, const Image<float>& image);
/// 16-bit TIFF, 1 or 3 channels, Deflate strips. Atomic.
void write_tiff16(const std::filesystem::path& path, const Image<std::uint16_t>& image);

/// PNG with 1 or 3 (R, G, B) channels of 8 or 16 bits. Atomic.
void write_png(const std::filesystem::path& path, const Image<std::uint8_t>& image);
void write_png16(const std::filesystem::path& path, const Image<std::uint16_t>& image);

}  // namespace malus
