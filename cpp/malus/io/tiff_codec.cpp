#include <tiffio.h>

#include <algorithm>
#include <cstdarg>
#include <cstdio>
#include <cstring>
#include <exception>
#include <limits>
#include <memory>
#include <stdexcept>

#include "malus/io/image_codecs_internal.h"

namespace malus::codecs {
namespace {

struct Close {
  void operator()(TIFF* tiff) const { TIFFClose(tiff); }
};
using Handle = std::unique_ptr<TIFF, Close>;

/// Keeps the first error of one file in a text; libtiff's own handler would print it.
int keep_error(TIFF*, void* user, const char*, const char* format, va_list arguments) {
  auto& error = *static_cast<std::string*>(user);
  if (error.empty()) {
    char text[512];
    std::vsnprintf(text, sizeof text, format, arguments);
    error = text;
  }
  return 1;
}

int drop_warning(TIFF*, void*, const char*, const char*, va_list) {
  return 1;
}

struct Options {
  explicit Options(std::string& error) : options(TIFFOpenOptionsAlloc()) {
    TIFFOpenOptionsSetErrorHandlerExtR(options, keep_error, &error);
    TIFFOpenOptionsSetWarningHandlerExtR(options, drop_warning, nullptr);
  }
  ~Options() { TIFFOpenOptionsFree(options); }
  Options(const Options&) = delete;
  Options& operator=(const Options&) = delete;
  TIFFOpenOptions* options;
};

/// A file that libtiff reads or writes through its client interface; handles point to this base.
struct Stream {
  toff_t position = 0, size = 0;
};

/// A file in memory.
struct Source : Stream {
  explicit Source(std::string_view content) : Stream{0, content.size()}, bytes(content) {}

  std::string_view bytes;
};

/// A file that is written. Errors name the file and the system's reason.
struct Target : Stream {
  explicit Target(AtomicFile& written) : file(written) {}

  AtomicFile& file;
  std::exception_ptr failure;  ///< libtiff is C: no exception may pass it
};

toff_t seek(thandle_t handle, toff_t offset, int whence) {
  auto& stream = *static_cast<Stream*>(handle);
  const toff_t base = whence == SEEK_CUR ? stream.position : whence == SEEK_END ? stream.size : 0;
  stream.position = base + offset;
  return stream.position;
}
toff_t size_of(thandle_t handle) {
  return static_cast<Stream*>(handle)->size;
}
int keep_open(thandle_t) {
  return 0;
}

tmsize_t target_read(thandle_t, void*, tmsize_t) {
  return -1;  // called only for files with several images
}
tmsize_t target_write(thandle_t handle, void* data, tmsize_t size) {
  auto& target = *static_cast<Target*>(static_cast<Stream*>(handle));
  try {
    target.file.write_at(target.position, data, static_cast<std::size_t>(size));
  } catch (...) {
    if (!target.failure) target.failure = std::current_exception();
    return -1;
  }
  target.position += static_cast<toff_t>(size);
  target.size = std::max(target.size, target.position);
  return size;
}

tmsize_t source_read(thandle_t handle, void* target, tmsize_t size) {
  auto& source = *static_cast<Source*>(static_cast<Stream*>(handle));
  if (source.position >= source.size) return 0;
  const std::size_t count =
      std::min<std::size_t>(static_cast<std::size_t>(size), source.bytes.size() - source.position);
  std::memcpy(target, source.bytes.data() + source.position, count);
  source.position += count;
  return static_cast<tmsize_t>(count);
}
tmsize_t source_write(thandle_t, void*, tmsize_t) {
  return 0;
}

/// How the samples of a file are stored.
struct Layout {
  Size size;
  std::uint32_t block_width = 0, block_height = 0;  ///< of a tile, or of a strip (image width × rows)
  std::uint16_t samples = 1, bits = 1, format = SAMPLEFORMAT_UINT, photometric = 0, compression = COMPRESSION_NONE;
  bool tiled = false, planar = false;
  int channels = 1;
  bool alpha = false;  ///< the last of the channels

  std::size_t sample_bytes() const { return bits / 8; }
};

template <class T>
T field(TIFF* tiff, ttag_t tag, T fallback) {
  T value = fallback;
  return TIFFGetFieldDefaulted(tiff, tag, &value) ? value : fallback;
}

/// Whether the samples that follow those of the color begin with an opacity; other programs also keep selections there.
bool has_alpha(TIFF* tiff) {
  std::uint16_t count = 0;
  std::uint16_t* kinds = nullptr;
  return TIFFGetField(tiff, TIFFTAG_EXTRASAMPLES, &count, &kinds) != 0 && count > 0 &&
         (kinds[0] == EXTRASAMPLE_ASSOCALPHA || kinds[0] == EXTRASAMPLE_UNASSALPHA);
}

/// RawImage::no_data.
std::optional<std::string> read_no_data(TIFF* tiff) {
  const TIFFField* field = TIFFFindField(tiff, gdal_nodata_tag, TIFF_ANY);
  if (field == nullptr) return std::nullopt;
  // If GDAL is used in the same process, it has told libtiff of the tag, for files without it, too: a text without its
  // length.
  if (TIFFFieldPassCount(field) == 0) {
    const char* text = nullptr;
    const bool is_given = TIFFFieldDataType(field) == TIFF_ASCII && TIFFGetField(tiff, gdal_nodata_tag, &text) != 0;
    return is_given && text != nullptr ? std::optional<std::string>(text) : std::nullopt;
  }
  // Otherwise libtiff knows the tag from this file only: a field of the type that the file states, with its length.
  std::uint32_t length = 0;
  const void* bytes = nullptr;
  if (TIFFFieldDataType(field) != TIFF_ASCII || TIFFGetField(tiff, gdal_nodata_tag, &length, &bytes) == 0 ||
      bytes == nullptr) {
    return "";
  }
  const std::string_view text(static_cast<const char*>(bytes), length);
  return std::string(text.substr(0, text.find('\0')));
}

Layout read_layout(TIFF* tiff, Alpha alpha) {
  Layout layout;
  const auto width = field<std::uint32_t>(tiff, TIFFTAG_IMAGEWIDTH, 0);
  const auto height = field<std::uint32_t>(tiff, TIFFTAG_IMAGELENGTH, 0);
  if (width < 1 || height < 1 || width > (1u << 20) || height > (1u << 20)) {
    throw std::runtime_error("has no usable size (" + std::to_string(width) + " x " + std::to_string(height) + ")");
  }
  layout.size = {static_cast<int>(width), static_cast<int>(height)};
  layout.samples = field<std::uint16_t>(tiff, TIFFTAG_SAMPLESPERPIXEL, 1);
  layout.bits = field<std::uint16_t>(tiff, TIFFTAG_BITSPERSAMPLE, 1);
  layout.format = field<std::uint16_t>(tiff, TIFFTAG_SAMPLEFORMAT, SAMPLEFORMAT_UINT);
  layout.photometric = field<std::uint16_t>(tiff, TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_MINISBLACK);
  layout.compression = field<std::uint16_t>(tiff, TIFFTAG_COMPRESSION, COMPRESSION_NONE);
  layout.planar = field<std::uint16_t>(tiff, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG) == PLANARCONFIG_SEPARATE;
  layout.tiled = TIFFIsTiled(tiff) != 0;

  const bool is_float = layout.format == SAMPLEFORMAT_IEEEFP && (layout.bits == 32 || layout.bits == 64);
  const bool is_unsigned = layout.format == SAMPLEFORMAT_UINT && (layout.bits == 8 || layout.bits == 16);
  if (!is_float && !is_unsigned) {
    throw std::runtime_error("has " + std::to_string(layout.bits) +
                             (layout.format == SAMPLEFORMAT_IEEEFP ? "-bit float"
                              : layout.format == SAMPLEFORMAT_UINT ? "-bit unsigned"
                                                                   : "-bit signed or unknown") +
                             " samples, expected 8 or 16 bits unsigned, or 32 or 64 bits float");
  }
  if (layout.photometric == PHOTOMETRIC_YCBCR && layout.compression == COMPRESSION_JPEG) {
    TIFFSetField(tiff, TIFFTAG_JPEGCOLORMODE, JPEGCOLORMODE_RGB);
    layout.photometric = PHOTOMETRIC_RGB;
  }
  if (layout.photometric != PHOTOMETRIC_MINISBLACK && layout.photometric != PHOTOMETRIC_MINISWHITE &&
      layout.photometric != PHOTOMETRIC_RGB) {
    throw std::runtime_error((layout.photometric == PHOTOMETRIC_PALETTE
                                  ? "has a palette: its pixels are colors of a table"
                                  : "has photometric interpretation " + std::to_string(layout.photometric)) +
                             ", expected gray or RGB");
  }
  if (layout.samples < 1 || layout.samples > 4) {
    throw std::runtime_error("has " + std::to_string(layout.samples) + " samples a pixel, expected 1 to 4");
  }
  layout.channels = layout.samples >= 3 ? 3 : 1;
  layout.alpha = alpha == Alpha::kept && layout.samples > layout.channels && has_alpha(tiff);
  if (layout.alpha) ++layout.channels;

  if (layout.tiled) {
    layout.block_width = field<std::uint32_t>(tiff, TIFFTAG_TILEWIDTH, 0);
    layout.block_height = field<std::uint32_t>(tiff, TIFFTAG_TILELENGTH, 0);
  } else {
    layout.block_width = width;
    layout.block_height = std::min(field<std::uint32_t>(tiff, TIFFTAG_ROWSPERSTRIP, height), height);
  }
  constexpr std::uint64_t largest_tile_side = 1 << 14;
  if (layout.block_width < 1 || layout.block_height < 1 ||
      (layout.tiled && (layout.block_width > largest_tile_side || layout.block_height > largest_tile_side))) {
    throw std::runtime_error("has tiles or strips of an impossible size");
  }
  return layout;
}

/// Memory for a block is allocated before the block is read, so a small file must not claim a block far larger than its
/// image.
void check_block(const Layout& layout) {
  constexpr std::size_t always_taken = 32 << 20, most_images = 4;
  const std::size_t area = std::size_t{layout.block_width} * layout.block_height;
  if (area * layout.samples * layout.sample_bytes() > always_taken && area > most_images * layout.size.area()) {
    throw std::runtime_error("has tiles far larger than its image");
  }
}

/// The most bytes of samples for each byte of the file.
double densest(std::uint16_t compression) {
  switch (compression) {
    case COMPRESSION_NONE:
      return 1;
    case COMPRESSION_LZMA:
      return 8192;  // a match of 273 bytes takes 14 decisions of 0.022 bits or more
    case COMPRESSION_ZSTD:
      return 32768;  // a run of 128 KB takes 4 bytes
    case COMPRESSION_LERC:
    case COMPRESSION_WEBP:
      return std::numeric_limits<double>::infinity();  // an even block of any size takes a few bytes
    default:
      return 4096;  // LZW strings reach 4096 bytes for 12 bits, and nothing else is much denser
  }
}

double most_pixels(const Layout& layout, std::size_t file_bytes) {
  return densest(layout.compression) * static_cast<double>(file_bytes) /
         static_cast<double>(layout.samples * layout.sample_bytes());
}

template <class Sample>
void copy_samples(const Layout& layout, const unsigned char* block, std::uint32_t x0, std::uint32_t y0, int plane,
                  Image<float>& pixels) {
  const std::size_t stored = layout.planar ? 1 : layout.samples;
  const int first = layout.planar ? plane : 0, last = layout.planar ? plane + 1 : layout.channels;
  const auto x1 = std::min<std::uint32_t>(x0 + layout.block_width, static_cast<std::uint32_t>(layout.size.width));
  const auto y1 = std::min<std::uint32_t>(y0 + layout.block_height, static_cast<std::uint32_t>(layout.size.height));
  for (std::uint32_t y = y0; y < y1; ++y) {
    const unsigned char* pixel = block + std::size_t{y - y0} * layout.block_width * stored * sizeof(Sample);
    float* target = &pixels(static_cast<int>(x0), static_cast<int>(y));
    for (std::uint32_t x = x0; x < x1; ++x) {
      for (int c = first; c < last; ++c) {
        Sample sample;
        std::memcpy(&sample, pixel + static_cast<std::size_t>(c - first) * sizeof(Sample), sizeof(Sample));
        target[c] = static_cast<float>(sample);
      }
      pixel += stored * sizeof(Sample);
      target += layout.channels;
    }
  }
}

void copy_block(const Layout& layout, const unsigned char* block, std::uint32_t x0, std::uint32_t y0, int plane,
                Image<float>& pixels) {
  const auto copy = [&]<class Sample>(Sample) { copy_samples<Sample>(layout, block, x0, y0, plane, pixels); };
  if (layout.format == SAMPLEFORMAT_IEEEFP) return layout.bits == 32 ? copy(float{}) : copy(double{});
  return layout.bits == 8 ? copy(std::uint8_t{}) : copy(std::uint16_t{});
}

void read_blocks(TIFF* tiff, const Layout& layout, const std::string& error, Image<float>& pixels) {
  const tmsize_t block_bytes = layout.tiled ? TIFFTileSize(tiff) : TIFFStripSize(tiff);
  const std::size_t expected = std::size_t{layout.block_width} * layout.block_height *
                               (layout.planar ? 1 : layout.samples) * layout.sample_bytes();
  if (block_bytes <= 0 || static_cast<std::size_t>(block_bytes) < expected) {
    throw std::runtime_error("has tiles or strips of an impossible size");
  }
  LargeVector<unsigned char> block(static_cast<std::size_t>(block_bytes));
  const auto width = static_cast<std::uint32_t>(layout.size.width);
  const auto height = static_cast<std::uint32_t>(layout.size.height);
  const int planes = layout.planar ? layout.channels : 1;
  std::uint32_t index = 0;
  for (int plane = 0; plane < planes; ++plane) {
    for (std::uint32_t y = 0; y < height; y += layout.block_height) {
      for (std::uint32_t x = 0; x < width; x += layout.block_width, ++index) {
        const std::uint32_t rows = layout.tiled ? layout.block_height : std::min(layout.block_height, height - y);
        const auto wanted = static_cast<tmsize_t>(expected / layout.block_height * rows);
        const tmsize_t got = layout.tiled ? TIFFReadEncodedTile(tiff, index, block.data(), block_bytes)
                                          : TIFFReadEncodedStrip(tiff, index, block.data(), block_bytes);
        if (got < wanted || !error.empty())
          throw std::runtime_error("is truncated or damaged" + (error.empty() ? "" : " (" + error + ")"));
        copy_block(layout, block.data(), x, y, plane, pixels);
      }
    }
  }
}

/// Uncompressed or Deflate strips of about a megabyte; Deflate with the horizontal predictor.
template <class Sample>
void encode(AtomicFile& file, const Image<Sample>& image, int format, int compression,
            const std::function<void(TIFF*)>& add_tags) {
  std::string error;
  const Options options(error);
  const std::size_t data_bytes = image.count() * sizeof(Sample);
  const char* mode = data_bytes > (std::size_t{1} << 32) - (std::size_t{1} << 26) ? "w8" : "w";
  Target target(file);
  const auto require = [&](bool done) {
    if (target.failure) std::rethrow_exception(target.failure);
    if (!done) throw resource_error("cannot write " + file.path().string() + ": " + error);
  };
  Handle tiff(TIFFClientOpenExt("image", mode, static_cast<Stream*>(&target), target_read, target_write, seek,
                                keep_open, size_of, nullptr, nullptr, options.options));
  require(tiff != nullptr);
  const std::size_t row_samples = static_cast<std::size_t>(image.width()) * static_cast<std::size_t>(image.channels());
  const auto rows_per_strip = static_cast<int>(std::max<std::size_t>(1, (1 << 20) / (row_samples * sizeof(Sample))));
  const auto set = [&](ttag_t tag, int value) { TIFFSetField(tiff.get(), tag, value); };
  set(TIFFTAG_IMAGEWIDTH, image.width());
  set(TIFFTAG_IMAGELENGTH, image.height());
  set(TIFFTAG_SAMPLESPERPIXEL, image.channels());
  set(TIFFTAG_BITSPERSAMPLE, 8 * static_cast<int>(sizeof(Sample)));
  set(TIFFTAG_SAMPLEFORMAT, format);
  set(TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG);
  set(TIFFTAG_COMPRESSION, compression);
  if (compression != COMPRESSION_NONE) set(TIFFTAG_PREDICTOR, PREDICTOR_HORIZONTAL);
  set(TIFFTAG_PHOTOMETRIC, image.channels() == 3 ? PHOTOMETRIC_RGB : PHOTOMETRIC_MINISBLACK);
  set(TIFFTAG_ROWSPERSTRIP, rows_per_strip);
  if (add_tags) add_tags(tiff.get());
  std::uint32_t strip = 0;
  for (int v = 0; v < image.height(); v += rows_per_strip, ++strip) {
    const std::size_t samples = static_cast<std::size_t>(std::min(rows_per_strip, image.height() - v)) * row_samples;
    // libtiff's interface is not const-correct; it copies the data before it swaps bytes or predicts.
    auto* data = const_cast<Sample*>(image.row(v));
    require(TIFFWriteEncodedStrip(tiff.get(), strip, data, static_cast<tmsize_t>(samples * sizeof(Sample))) >= 0);
  }
  require(TIFFFlush(tiff.get()) != 0);
  tiff.reset();
  require(error.empty());
}

/// Throws if the file holds another image of the same size, such as the frames of a series: only the first one would
/// be used. Previews and masks, which say what they are, do not count.
void require_one_image(TIFF* tiff, Size size) {
  constexpr int most_pages = 100;
  for (int page = 1; page < most_pages && TIFFReadDirectory(tiff) != 0; ++page) {
    const auto kind = field<std::uint32_t>(tiff, TIFFTAG_SUBFILETYPE, 0);
    if ((kind & (FILETYPE_REDUCEDIMAGE | FILETYPE_MASK)) != 0) continue;
    if (field<std::uint32_t>(tiff, TIFFTAG_IMAGEWIDTH, 0) == static_cast<std::uint32_t>(size.width) &&
        field<std::uint32_t>(tiff, TIFFTAG_IMAGELENGTH, 0) == static_cast<std::uint32_t>(size.height))
      throw std::runtime_error("holds several images (pages), expected one; save each as a file of its own");
  }
}

}  // namespace

RawImage decode_tiff(std::string_view bytes, Alpha alpha, const HeaderCheck& check) {
  std::string error;
  const Options options(error);
  Source source(bytes);
  const Handle tiff(TIFFClientOpenExt("image", "rm", static_cast<Stream*>(&source), source_read, source_write, seek,
                                      keep_open, size_of, nullptr, nullptr, options.options));
  if (!tiff) throw std::runtime_error("is not a readable TIFF (" + error + ")");
  const Layout layout = read_layout(tiff.get(), alpha);
  check_block(layout);
  check({layout.size, layout.channels, most_pixels(layout, bytes.size())});

  RawImage image{Image<float>::uninitialized(layout.size, layout.channels), layout.bits};
  image.no_data = read_no_data(tiff.get());
  read_blocks(tiff.get(), layout, error, image.pixels);
  require_one_image(tiff.get(), layout.size);
  if (layout.photometric == PHOTOMETRIC_MINISWHITE) {
    const auto white = static_cast<float>(image.full_scale_dn());
    const auto channels = static_cast<std::size_t>(layout.channels), colors = channels - (layout.alpha ? 1 : 0);
    for (std::size_t i = 0; i < image.pixels.count(); ++i) {
      if (i % channels < colors) image.pixels[i] = white - image.pixels[i];
    }
  }
  return image;
}

void encode_float_tiff(AtomicFile& file, const Image<float>& image, const std::function<void(TIFF*)>& add_tags) {
  encode(file, image, SAMPLEFORMAT_IEEEFP, COMPRESSION_NONE, add_tags);
}

void encode_tiff16(AtomicFile& file, const Image<std::uint16_t>& image) {
  encode(file, image, SAMPLEFORMAT_UINT, COMPRESSION_ADOBE_DEFLATE, {});
}

}  // namespace malus::codecs
