#include <sys/resource.h>
#include <tiffio.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <random>

#include "malus/io/image_file_internal.h"
#include "malus/io/input_file_internal.h"
#include "temporary_folder.h"
#include "thrown_error.h"

namespace malus {
namespace {

template <class T>
Image<T> pattern(Size size, int channels) {
  Image<T> image(size, channels);
  std::mt19937 random(7);
  for (std::size_t i = 0; i < image.count(); ++i) image[i] = static_cast<T>(random() >> 8);
  return image;
}

template <class T>
void expect_pixels(const Image<float>& read, const Image<T>& written) {
  ASSERT_EQ(read.size(), written.size());
  ASSERT_EQ(read.channels(), written.channels());
  for (std::size_t i = 0; i < read.count(); ++i) ASSERT_EQ(read[i], static_cast<float>(written[i])) << i;
}

TEST(ImageFile, PngOfEightAndSixteenBitsRoundTrips) {
  const TemporaryFolder folder;
  for (const int channels : {1, 3}) {
    const auto bytes = pattern<std::uint8_t>({37, 21}, channels);
    write_png(folder / "8.png", bytes);
    const RawImage eight = read_image(folder / "8.png");
    expect_pixels(eight.pixels, bytes);
    EXPECT_EQ(eight.bits, 8);
    EXPECT_EQ(eight.full_scale_dn(), 255);
    const auto words = pattern<std::uint16_t>({37, 21}, channels);
    write_png16(folder / "16.png", words);
    const RawImage sixteen = read_image(folder / "16.png");
    expect_pixels(sixteen.pixels, words);
    EXPECT_EQ(sixteen.bits, 16);
    EXPECT_EQ(sixteen.full_scale_dn(), 65535);
    EXPECT_EQ(read_image_size(folder / "16.png"), (Size{37, 21}));
  }
}

// OpenCV is the independent writer and reader here; its channel order is B, G, R.
TEST(ImageFile, AgreesWithOpenCv) {
  const TemporaryFolder folder;
  for (const std::string name : {"a.png", "a.tif", "a.jpg"}) {
    for (const int type : {CV_8UC1, CV_8UC3, CV_16UC1, CV_16UC3, CV_32FC1, CV_32FC3}) {
      if ((name == "a.jpg" && CV_MAT_DEPTH(type) != CV_8U) || (name == "a.png" && CV_MAT_DEPTH(type) == CV_32F))
        continue;
      cv::Mat mat(24, 40, type);
      cv::randu(mat, 0, CV_MAT_DEPTH(type) == CV_16U ? 65535 : 255);
      const std::string path = (folder / name).string();
      // Without this option OpenCV stores three float channels as 16-bit LogLuv.
      ASSERT_TRUE(cv::imwrite(path, mat, {cv::IMWRITE_TIFF_COMPRESSION, 1}));
      const cv::Mat expected = cv::imread(path, cv::IMREAD_UNCHANGED);
      const RawImage image = read_image(path);
      ASSERT_EQ(image.pixels.size(), (Size{40, 24}));
      ASSERT_EQ(image.pixels.channels(), expected.channels());
      cv::Mat as_float;
      expected.convertTo(as_float, CV_32F);
      for (int v = 0; v < 24; ++v) {
        for (int u = 0; u < 40; ++u) {
          for (int c = 0; c < expected.channels(); ++c) {
            const int bgr = expected.channels() == 3 ? 2 - c : 0;
            ASSERT_EQ(image.pixels(u, v, c), as_float.ptr<float>(v)[u * expected.channels() + bgr]) << name << type;
          }
        }
      }
    }
  }
}

TEST(ImageFile, AlphaIsDropped) {
  const TemporaryFolder folder;
  for (const std::string name : {"a.png", "a.tif"}) {
    cv::imwrite((folder / name).string(), cv::Mat(5, 6, CV_8UC4, cv::Scalar(10, 20, 30, 40)));
    const RawImage image = read_image(folder / name);
    ASSERT_EQ(image.pixels.channels(), 3);
    EXPECT_EQ(image.pixels(2, 3, 0), 30);
    EXPECT_EQ(image.pixels(2, 3, 1), 20);
    EXPECT_EQ(image.pixels(2, 3, 2), 10);
  }
}

TEST(ImageFile, ATiffWithSeveralImagesIsRefused) {
  const TemporaryFolder folder;
  const std::string path = (folder / "burst.tif").string();
  const cv::Mat frame(5, 6, CV_16UC1, cv::Scalar(10)), preview(2, 3, CV_16UC1, cv::Scalar(10));
  cv::imwritemulti(path, std::vector<cv::Mat>{frame, preview});
  EXPECT_EQ(read_image(path).pixels.size(), (Size{6, 5}));
  cv::imwritemulti(path, std::vector<cv::Mat>{frame, preview, frame});
  EXPECT_EQ(read_image_size(path), (Size{6, 5}));
  expect_error(
      ErrorCode::input, [&] { read_image(path); }, "burst.tif", "several images");
}

struct TiffLayout {
  const char* mode;
  int planar, photometric, tile;
};

// libtiff writes these layouts. Each pixel's value encodes its position and channel.
TEST(ImageFile, ReadsTiffLayoutsThatOpenCvDoesNotWrite) {
  const TemporaryFolder folder;
  const int width = 50, height = 37;
  for (const TiffLayout& layout : {TiffLayout{"w", PLANARCONFIG_SEPARATE, PHOTOMETRIC_RGB, 0},
                                   TiffLayout{"w", PLANARCONFIG_CONTIG, PHOTOMETRIC_RGB, 32},
                                   TiffLayout{"w", PLANARCONFIG_SEPARATE, PHOTOMETRIC_RGB, 16},
                                   TiffLayout{"wb8", PLANARCONFIG_CONTIG, PHOTOMETRIC_MINISBLACK, 0},
                                   TiffLayout{"w", PLANARCONFIG_CONTIG, PHOTOMETRIC_MINISWHITE, 0}}) {
    const int channels = layout.photometric == PHOTOMETRIC_RGB ? 3 : 1;
    const auto value = [&](int u, int v, int c) { return static_cast<std::uint16_t>(100 * v + u + 20000 * c); };
    const std::string path = (folder / "a.tif").string();
    TIFF* tiff = TIFFOpen(path.c_str(), layout.mode);
    TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, width);
    TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, height);
    TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, channels);
    TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, 16);
    TIFFSetField(tiff, TIFFTAG_PLANARCONFIG, layout.planar);
    TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, layout.photometric);
    const int side = layout.tile > 0 ? layout.tile : width, rows = layout.tile > 0 ? layout.tile : 5;
    if (layout.tile > 0) {
      TIFFSetField(tiff, TIFFTAG_TILEWIDTH, side);
      TIFFSetField(tiff, TIFFTAG_TILELENGTH, rows);
    } else {
      TIFFSetField(tiff, TIFFTAG_ROWSPERSTRIP, rows);
    }
    const int planes = layout.planar == PLANARCONFIG_SEPARATE ? channels : 1, together = channels / planes;
    std::uint32_t block = 0;
    for (int plane = 0; plane < planes; ++plane) {
      for (int v0 = 0; v0 < height; v0 += rows) {
        for (int u0 = 0; u0 < width; u0 += side, ++block) {
          const int block_rows = layout.tile > 0 ? rows : std::min(rows, height - v0);
          std::vector<std::uint16_t> samples;
          for (int v = v0; v < v0 + block_rows; ++v) {
            for (int u = u0; u < u0 + side; ++u) {
              for (int c = 0; c < together; ++c) samples.push_back(value(u, v, plane + c));
            }
          }
          const auto bytes = static_cast<tmsize_t>(samples.size() * sizeof(std::uint16_t));
          ASSERT_GE(layout.tile > 0 ? TIFFWriteEncodedTile(tiff, block, samples.data(), bytes)
                                    : TIFFWriteEncodedStrip(tiff, block, samples.data(), bytes),
                    0);
        }
      }
    }
    TIFFClose(tiff);
    const RawImage image = read_image(path);
    ASSERT_EQ(image.pixels.size(), (Size{width, height}));
    ASSERT_EQ(image.pixels.channels(), channels);
    for (int v = 0; v < height; ++v) {
      for (int u = 0; u < width; ++u) {
        for (int c = 0; c < channels; ++c) {
          const int stored = value(u, v, c);
          ASSERT_EQ(image.pixels(u, v, c), layout.photometric == PHOTOMETRIC_MINISWHITE ? 65535 - stored : stored);
        }
      }
    }
  }
}

TEST(ImageFile, ATileFarLargerThanItsImageIsRefused) {
  const TemporaryFolder folder;
  const std::string path = (folder / "a.tif").string();
  TIFF* tiff = TIFFOpen(path.c_str(), "w");
  for (const ttag_t side : {TIFFTAG_IMAGEWIDTH, TIFFTAG_IMAGELENGTH}) TIFFSetField(tiff, side, 8);
  for (const ttag_t side : {TIFFTAG_TILEWIDTH, TIFFTAG_TILELENGTH}) TIFFSetField(tiff, side, 1 << 14);
  TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, 1);
  TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, 8);
  TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_MINISBLACK);
  char bytes[16] = {};
  TIFFWriteRawTile(tiff, 0, bytes, sizeof bytes);
  TIFFClose(tiff);
  expect_error(
      ErrorCode::input, [&] { read_image(path); }, "a.tif", "tiles far larger than its image");
}

TEST(ImageFile, EvenImagesMayBeFarLargerThanTheirFiles) {
  const TemporaryFolder folder;
  cv::Mat mask(2000, 4000, CV_8UC1, cv::Scalar(0));
  mask(cv::Rect(1000, 500, 2000, 1000)).setTo(255);
  const auto expect_read = [&](const std::filesystem::path& path, std::uintmax_t least_ratio) {
    ASSERT_GT(mask.total(), least_ratio * std::filesystem::file_size(path)) << "not dense enough for this test";
    const Image<float> read = read_image(path).pixels;
    ASSERT_EQ(read.size(), (Size{4000, 2000}));
    EXPECT_EQ(read(999, 1000), 0);
    EXPECT_EQ(read(1000, 1000), 255);
  };
  const std::filesystem::path png = folder / "mask.png", tif = folder / "mask.tif";
  ASSERT_TRUE(cv::imwrite(png.string(), mask, {cv::IMWRITE_PNG_BILEVEL, 1, cv::IMWRITE_PNG_COMPRESSION, 9}));
  expect_read(png, 1032);
  if (TIFFIsCODECConfigured(COMPRESSION_LZMA) == 0) GTEST_SKIP() << "libtiff without LZMA";
  TIFF* tiff = TIFFOpen(tif.string().c_str(), "w");
  TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, mask.cols);
  for (const ttag_t rows : {TIFFTAG_IMAGELENGTH, TIFFTAG_ROWSPERSTRIP}) TIFFSetField(tiff, rows, mask.rows);
  TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, 1);
  TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, 8);
  TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_MINISBLACK);
  TIFFSetField(tiff, TIFFTAG_COMPRESSION, COMPRESSION_LZMA);
  ASSERT_GE(TIFFWriteEncodedStrip(tiff, 0, mask.data, static_cast<tmsize_t>(mask.total())), 0);
  TIFFClose(tiff);
  expect_read(tif, 4096);
}

TEST(ImageFile, FloatTiffKeepsEveryBit) {
  const TemporaryFolder folder;
  for (const int channels : {1, 3}) {
    Image<float> raster({301, 203}, channels);
    for (std::size_t i = 0; i < raster.count(); ++i) raster[i] = std::sin(0.1f * static_cast<float>(i)) * 1e-3f + 600;
    raster(5, 6) = std::nanf("");
    raster(300, 202) = -0.0f;
    write_float_tiff(folder / "depth.tif", raster);
    const Image<float> read = read_float_raster(folder / "depth.tif");
    ASSERT_EQ(read.size(), raster.size());
    ASSERT_EQ(read.channels(), channels);
    EXPECT_EQ(std::memcmp(read.data(), raster.data(), raster.count() * sizeof(float)), 0);
    const cv::Mat other = cv::imread((folder / "depth.tif").string(), cv::IMREAD_UNCHANGED);
    ASSERT_EQ(other.channels(), channels);
    EXPECT_EQ(other.ptr<float>(7)[11 * channels + (channels == 3 ? 2 : 0)], raster(11, 7, 0));
  }
}

/// Writes the depths 5, 9999, -9999 and 7 with GDAL's nodata tag of a type, from libtiff's value.
template <class Sample, class Value>
void write_with_no_data(const std::filesystem::path& path, TIFFDataType type, Value value) {
  TIFF* tiff = TIFFOpen(path.c_str(), "w");
  char name[] = "GDALNoDataValue";
  const bool is_text = type == TIFF_ASCII;
  const short count = is_text ? TIFF_VARIABLE : 1;
  const TIFFFieldInfo field{42113, count, count, type, FIELD_CUSTOM, 1, 0, name};
  TIFFMergeFieldInfo(tiff, &field, 1);
  TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, 4);
  TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, 1);
  TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, 1);
  TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, static_cast<int>(8 * sizeof(Sample)));
  TIFFSetField(tiff, TIFFTAG_SAMPLEFORMAT, SAMPLEFORMAT_IEEEFP);
  TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_MINISBLACK);
  TIFFSetField(tiff, 42113, value);
  Sample row[] = {5, static_cast<Sample>(9999.1), -9999, std::numeric_limits<Sample>::max()};
  ASSERT_EQ(TIFFWriteScanline(tiff, row, 0, 0), 1);
  TIFFClose(tiff);
}

TEST(ImageFile, PixelsOfGdalsNoDataValueAreHoles) {
  const TemporaryFolder folder;
  const auto holes = [&] {
    std::string found;
    for (const float value : read_float_raster(folder / "depth.tif")) found += std::isnan(value) ? 'o' : '.';
    return found;
  };
  // GDAL rounds the largest numbers of both types to 15 digits, beyond their range.
  for (const auto& [text, expected] :
       {std::pair{"9999.1", ".o.."}, std::pair{"-9999", "..o."}, std::pair{" +5.0e+00 ", "o..."},
        std::pair{"nan", "...."}, std::pair{"0", "...."}, std::pair{"3.40282346638529e+38", "...o"}}) {
    write_with_no_data<float>(folder / "depth.tif", TIFF_ASCII, text);
    EXPECT_EQ(holes(), expected) << text;
  }
  write_with_no_data<double>(folder / "depth.tif", TIFF_ASCII, "9999.1");
  EXPECT_EQ(holes(), ".o..");
  write_with_no_data<double>(folder / "depth.tif", TIFF_ASCII, "1.79769313486232e+308");
  EXPECT_EQ(holes(), "...o");
}

/// Tells libtiff of the tag in all files, as GDAL does when it is first used in a process.
class KnownNoDataTag {
 public:
  KnownNoDataTag() : before_(TIFFSetTagExtender(tell)) {}
  ~KnownNoDataTag() { TIFFSetTagExtender(before_); }
  KnownNoDataTag(const KnownNoDataTag&) = delete;
  KnownNoDataTag& operator=(const KnownNoDataTag&) = delete;

 private:
  static void tell(TIFF* tiff) {
    static char name[] = "GDALNoDataValue";
    static const TIFFFieldInfo field{42113, TIFF_VARIABLE, TIFF_VARIABLE, TIFF_ASCII, FIELD_CUSTOM, 1, 0, name};
    TIFFMergeFieldInfo(tiff, &field, 1);
  }

  TIFFExtendProc before_;
};

TEST(ImageFile, TheNoDataValueIsReadWhereGdalIsUsedToo) {
  const TemporaryFolder folder;
  write_with_no_data<float>(folder / "with.tif", TIFF_ASCII, "9999.1");
  write_float_tiff(folder / "without.tif", Image<float>({2, 1}, 1, 5.0F));
  const KnownNoDataTag tag;
  EXPECT_TRUE(std::isnan(read_float_raster(folder / "with.tif")(1, 0)));
  EXPECT_EQ(read_float_raster(folder / "with.tif")(0, 0), 5);
  EXPECT_EQ(read_float_raster(folder / "without.tif")(0, 0), 5) << "a file without the tag";
}

TEST(ImageFile, ADamagedNoDataValueIsAnErrorOfDepthsOnly) {
  const TemporaryFolder folder;
  const auto path = folder / "depth.tif";
  const auto expect_refused = [&](const char* part) {
    expect_error(
        ErrorCode::input, [&] { read_float_raster(path, "prior depth map"); }, "prior depth map", "depth.tif",
        "GDAL nodata tag (42113)", part);
    EXPECT_EQ(read_image(path).pixels(0, 0), 5) << "other images have no holes";
  };
  write_with_no_data<float>(path, TIFF_ASCII, "none");
  expect_refused("= \"none\", expected the number");
  write_with_no_data<float>(path, TIFF_ASCII, "");
  expect_refused("expected the number");
  write_with_no_data<float>(path, TIFF_ASCII, "1\n2");
  expect_refused("that is damaged");
  write_with_no_data<float>(path, TIFF_DOUBLE, 5.0);
  expect_refused("expected the number");
  // The tag's text is said to lie beyond the end of the file.
  write_with_no_data<float>(path, TIFF_ASCII, "-9999.125");
  std::string bytes = read_file(path, "image");
  const std::size_t entry = bytes.find("\x81\xa4\x02");
  ASSERT_NE(entry, std::string::npos);
  bytes[entry + 7] = '\x10';
  folder.write("depth.tif", bytes);
  expect_refused("that is damaged");
}

TEST(ImageFile, WritingATiffNeedsOneFileDescriptor) {
  const TemporaryFolder folder;
  const Image<float> raster({3, 2}, 1, 1.5F);
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  const int next = dup(0);
  ASSERT_GE(next, 0);
  close(next);
  const rlimit one_more{static_cast<rlim_t>(next) + 1, before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &one_more), 0);
  const auto write = [&] { write_float_tiff(folder / "depth.tif", raster); };
  EXPECT_NO_THROW(write());
  setrlimit(RLIMIT_NOFILE, &before);
  EXPECT_EQ(read_float_raster(folder / "depth.tif"), raster);
}

TEST(ImageFile, SixteenBitTiffRoundTripsAndIsReadByOpenCv) {
  const TemporaryFolder folder;
  for (const int channels : {1, 3}) {
    // Large enough for more than one strip.
    const auto words = pattern<std::uint16_t>({701, 403}, channels);
    write_tiff16(folder / "16.tif", words);
    const RawImage read = read_image(folder / "16.tif");
    expect_pixels(read.pixels, words);
    EXPECT_EQ(read.bits, 16);
    EXPECT_FALSE(read.is_float());
    const cv::Mat other = cv::imread((folder / "16.tif").string(), cv::IMREAD_UNCHANGED);
    ASSERT_EQ(other.type(), channels == 3 ? CV_16UC3 : CV_16UC1);
    EXPECT_EQ(other.ptr<std::uint16_t>(402)[700 * channels + (channels == 3 ? 2 : 0)], words(700, 402, 0));
  }
}

TEST(ImageFile, IntensityIsTheMeanOfTheChannelsOverFullScale) {
  const TemporaryFolder folder;
  for (const int channels : {1, 3}) {
    const auto words = pattern<std::uint16_t>({37, 21}, channels);
    write_tiff16(folder / "photo.tif", words);
    const Image<float> intensity = read_intensity(folder / "photo.tif");
    ASSERT_EQ(intensity.size(), words.size());
    ASSERT_EQ(intensity.channels(), 1);
    for (std::size_t i = 0; i < intensity.count(); ++i) {
      double sum = 0;
      const std::size_t first = i * static_cast<std::size_t>(channels);
      for (int c = 0; c < channels; ++c) sum += words[first + static_cast<std::size_t>(c)];
      ASSERT_NEAR(intensity[i], sum / channels / 65535, 1e-6) << i;
    }
  }
}

TEST(ImageFile, ReadsMaskAndLabels) {
  const TemporaryFolder folder;
  Image<std::uint8_t> labels({4, 2});
  labels(1, 0) = 1;
  labels(2, 1) = 2;
  write_png(folder / "label.png", labels);
  EXPECT_EQ(read_labels(folder / "label.png"), labels);
  const Mask mask = read_mask(folder / "label.png");
  EXPECT_EQ(mask(1, 0), 255);
  EXPECT_EQ(mask(2, 1), 255);
  EXPECT_EQ(mask(0, 0), 0);
  write_png(folder / "rgb.png", Image<std::uint8_t>({2, 2}, 3));
  expect_error(
      ErrorCode::input, [&] { read_labels(folder / "rgb.png"); }, "3 channels");
  expect_error(
      ErrorCode::input, [&] { read_float_raster(folder / "label.png"); }, "8-bit integer");
}

TEST(ImageFile, LabelsOfTwoBitsAreNotScaled) {
  const TemporaryFolder folder;
  // A gray PNG of 4 x 1 pixels of 2 bits: 0, 1, 2, 3.
  constexpr unsigned char png[] = {0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48,
                                   0x44, 0x52, 0x00, 0x00, 0x00, 0x04, 0x00, 0x00, 0x00, 0x01, 0x02, 0x00, 0x00, 0x00,
                                   0x00, 0x96, 0xe7, 0x48, 0xb0, 0x00, 0x00, 0x00, 0x0a, 0x49, 0x44, 0x41, 0x54, 0x78,
                                   0x9c, 0x63, 0x90, 0x06, 0x00, 0x00, 0x1d, 0x00, 0x1c, 0x8e, 0xf4, 0xf5, 0x21, 0x00,
                                   0x00, 0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82};
  const std::filesystem::path path = folder.write("label.png", {reinterpret_cast<const char*>(png), sizeof png});
  const Image<std::uint8_t> labels = read_labels(path);
  const Image<float> gray = read_image(path).pixels;
  ASSERT_EQ(labels.size(), (Size{4, 1}));
  for (int u = 0; u < 4; ++u) {
    EXPECT_EQ(labels(u, 0), u);
    EXPECT_EQ(gray(u, 0), 85 * u) << "white is 255 elsewhere";
  }
}

TEST(ImageFile, RefusesLabelsOfAPaletteInWords) {
  const TemporaryFolder folder;
  // A PNG of 4 x 1 pixels of 2 bits, which are places in a table of black, red and blue: 0, 1, 2, 0.
  constexpr unsigned char png[] = {
      0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48, 0x44, 0x52, 0x00, 0x00,
      0x00, 0x04, 0x00, 0x00, 0x00, 0x01, 0x02, 0x03, 0x00, 0x00, 0x00, 0x84, 0x52, 0xe7, 0x5e, 0x00, 0x00, 0x00,
      0x09, 0x50, 0x4c, 0x54, 0x45, 0x00, 0x00, 0x00, 0xc8, 0x00, 0x00, 0x00, 0x00, 0x5a, 0xf5, 0x66, 0xcd, 0xf3,
      0x00, 0x00, 0x00, 0x0a, 0x49, 0x44, 0x41, 0x54, 0x78, 0x9c, 0x63, 0x90, 0x00, 0x00, 0x00, 0x1a, 0x00, 0x19,
      0x2d, 0x88, 0xf4, 0x36, 0x00, 0x00, 0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82};
  const std::filesystem::path path = folder.write("label.png", {reinterpret_cast<const char*>(png), sizeof png});
  expect_error(
      ErrorCode::input, [&] { read_labels(path); }, "label image " + path.string() + " has a palette", "gray");
  const Mask mask = read_mask(path);
  EXPECT_EQ(mask(0, 0), 0);
  EXPECT_EQ(mask(1, 0), 255) << "in a mask the color counts";
  EXPECT_EQ(mask(2, 0), 255);
  EXPECT_EQ(mask(3, 0), 0);

  const std::string name = (folder / "label.tif").string();
  TIFF* tiff = TIFFOpen(name.c_str(), "w");
  std::vector<std::uint16_t> table(256);
  TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, 4);
  TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, 1);
  TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, 8);
  TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_PALETTE);
  TIFFSetField(tiff, TIFFTAG_COLORMAP, table.data(), table.data(), table.data());
  std::array<std::uint8_t, 4> row{0, 1, 2, 0};
  ASSERT_GE(TIFFWriteEncodedStrip(tiff, 0, row.data(), row.size()), 0);
  TIFFClose(tiff);
  expect_error(
      ErrorCode::input, [&] { read_mask(name); }, "mask " + name, "has a palette", "expected gray or RGB");
}

TEST(ImageFile, DistinguishesMasksFromPhotographs) {
  const TemporaryFolder folder;
  const auto mask_of = [&](auto value_of) {
    Image<std::uint8_t> image({60, 40});
    for (int v = 0; v < 40; ++v)
      for (int u = 0; u < 60; ++u) image(u, v) = static_cast<std::uint8_t>(value_of(u, v));
    write_png(folder / "mask.png", image);
    return read_mask(folder / "mask.png");
  };
  EXPECT_EQ(mask_of([](int u, int) { return u > 20 ? 255 : 0; })(30, 10), 255);
  // A mask with a soft edge two pixels wide, and with the noise that JPEG adds to black and white.
  EXPECT_EQ(mask_of([](int u, int v) { return u > 20 ? 240 + v % 15 : u > 18 ? 60 + 4 * v : v % 12; })(30, 10), 255);
  EXPECT_EQ(mask_of([](int u, int v) { return u > 20 ? 240 + v % 15 : v % 12; })(10, 11), 0)
      << "what compression adds to black is no object";
  EXPECT_EQ(mask_of([](int, int) { return 1; })(0, 0), 255);
  EXPECT_EQ(mask_of([](int u, int) { return u > 20 ? 12 : u > 10 ? 1 : 0; })(15, 10), 255) << "a small label";
  expect_error(
      ErrorCode::input, [&] { mask_of([](int, int) { return 0; }); }, "mask.png", "black everywhere");
  expect_error(
      ErrorCode::input, [&] { mask_of([](int u, int v) { return (7 * u + 5 * v) % 256; }); }, "mask.png",
      "looks like a photograph");
}

TEST(ImageFile, AMaskMayBeDrawnInAnyColor) {
  const TemporaryFolder folder;
  for (int channel = 0; channel < 3; ++channel) {
    // White and black with the noise that JPEG adds to them, in one color.
    Image<std::uint8_t> image({60, 40}, 3);
    for_each_pixel(image.size(), [&](int u, int v) {
      image(u, v, channel) = static_cast<std::uint8_t>(u > 20 ? 240 + v % 15 : v % 12);
    });
    write_png(folder / "mask.png", image);
    const Mask mask = read_mask(folder / "mask.png");
    EXPECT_EQ(mask(30, 10), 255) << channel;
    EXPECT_EQ(mask(10, 11), 0) << channel << ": what compression adds to black is no object";
    for_each_pixel(image.size(),
                   [&](int u, int v) { image(u, v, channel) = static_cast<std::uint8_t>((7 * u + 5 * v) % 256); });
    write_png(folder / "photo.png", image);
    expect_error(
        ErrorCode::input, [&] { read_mask(folder / "photo.png"); }, "looks like a photograph");
  }
}

TEST(ImageFile, TransparentPixelsAreOutsideOfAMask) {
  const TemporaryFolder folder;
  const auto expect_object_at_1 = [&](const char* name) {
    const Mask mask = read_mask(folder / name);
    EXPECT_EQ(mask(0, 0), 0) << name << ": white, but transparent";
    EXPECT_EQ(mask(1, 0), 255) << name;
    EXPECT_EQ(mask(2, 0), 0) << name << ": black";
    EXPECT_EQ(read_image(folder / name).pixels(0, 0), 255) << name << ": an image's alpha channel is dropped";
  };
  cv::Mat colored(1, 3, CV_8UC4, cv::Scalar::all(255));
  colored.at<cv::Vec4b>(0, 0)[3] = 0;
  colored.at<cv::Vec4b>(0, 2) = cv::Vec4b(0, 0, 0, 255);
  cv::imwrite((folder / "mask.png").string(), colored);
  expect_object_at_1("mask.png");

  for (const auto kind : {std::uint16_t{EXTRASAMPLE_UNASSALPHA}, std::uint16_t{EXTRASAMPLE_UNSPECIFIED}}) {
    TIFF* tiff = TIFFOpen((folder / "mask.tif").string().c_str(), "w");
    TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, 3);
    TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, 1);
    TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, 2);
    TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, 8);
    TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_MINISBLACK);
    TIFFSetField(tiff, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG);
    TIFFSetField(tiff, TIFFTAG_EXTRASAMPLES, 1, &kind);
    std::uint8_t row[] = {255, 0, 255, 255, 0, 255};
    TIFFWriteScanline(tiff, row, 0, 0);
    TIFFClose(tiff);
    if (kind == EXTRASAMPLE_UNASSALPHA) {
      expect_object_at_1("mask.tif");
    } else {
      EXPECT_EQ(read_mask(folder / "mask.tif")(0, 0), 255) << "another channel is not an opacity";
    }
  }
}

TEST(ImageFile, PixelsWithoutDataAreOutsideOfAMask) {
  const TemporaryFolder folder;
  Image<float> raster({3, 1}, 1, 1.0F);
  raster(0, 0) = raster(2, 0) = std::numeric_limits<float>::quiet_NaN();
  write_float_tiff(folder / "mask.tif", raster);
  const Mask mask = read_mask(folder / "mask.tif");
  EXPECT_EQ(mask(0, 0), 0);
  EXPECT_EQ(mask(1, 0), 255);
  EXPECT_EQ(mask(2, 0), 0);
}

TEST(ImageFile, RejectsWhatIsNotAnImage) {
  const TemporaryFolder folder;
  expect_error(
      ErrorCode::input, [&] { read_image(folder / "none.png", "polarized image"); }, "polarized image", "none.png",
      "no such file");
  expect_error(
      ErrorCode::input, [&] { read_image(folder.write("empty.png", "")); }, "is empty");
  expect_error(
      ErrorCode::input, [&] { read_image(folder.write("text.png", "hello there")); },
      "none of the images that can be read");
  expect_error(
      ErrorCode::input, [&] { read_image(folder.path()); }, "is a folder");
}

class EveryFormat : public testing::TestWithParam<const char*> {
 protected:
  std::string encoded() const {
    const auto path = folder_ / GetParam();
    cv::Mat mat(64, 96, CV_8UC3);
    cv::randu(mat, 0, 255);
    cv::imwrite(path.string(), mat);
    return read_file(path, "image");
  }
  TemporaryFolder folder_;
};

TEST_P(EveryFormat, TruncationIsAnErrorAtAnyLength) {
  const std::string bytes = encoded();
  for (std::size_t length = 1; length < bytes.size(); length += 1 + bytes.size() / 97) {
    const auto path = folder_.write("cut", bytes.substr(0, length));
    expect_error(
        ErrorCode::input, [&] { read_image(path); }, "cut");
  }
}

TEST_P(EveryFormat, DamageNeverCrashes) {
  const std::string bytes = encoded();
  std::mt19937 random(3);
  int rejected = 0;
  for (int round = 0; round < 400; ++round) {
    std::string damaged = bytes;
    const std::size_t span = round % 2 ? bytes.size() : std::min<std::size_t>(bytes.size(), 200);
    for (int i = 0; i < 3; ++i) damaged[random() % span] = static_cast<char>(random());
    try {
      read_image(folder_.write("damaged", damaged));
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::input) << error.what();
      ++rejected;
    }
  }
  EXPECT_GT(rejected, 100);
}

INSTANTIATE_TEST_SUITE_P(Formats, EveryFormat, testing::Values("a.png", "a.tif", "a.jpg"));

TEST(ImageFile, ASizeBeyondTheFilesBytesIsRefusedBeforeAllocating) {
  const TemporaryFolder folder;
  write_float_tiff(folder / "small.tif", Image<float>({64, 64}));
  std::string bytes = read_file(folder / "small.tif", "image");
  // ImageWidth is tag 256 (LONG or SHORT); its value sits eight bytes after the tag in the directory.
  std::uint32_t directory;
  std::memcpy(&directory, bytes.data() + 4, 4);
  std::uint16_t tag, type;
  std::memcpy(&tag, bytes.data() + directory + 2, 2);
  std::memcpy(&type, bytes.data() + directory + 4, 2);
  ASSERT_EQ(tag, 256);
  const std::uint32_t huge = type == 3 ? 60000 : 65536;
  std::memcpy(bytes.data() + directory + 10, &huge, 4);
  expect_error(
      ErrorCode::input, [&] { read_image(folder.write("huge.tif", bytes)); }, "huge.tif", "more than its bytes");
}

TEST(ImageFile, WritersRefuseWhatTheyCannotWrite) {
  const TemporaryFolder folder;
  expect_error(
      ErrorCode::input, [&] { write_png(folder / "a.png", Image<std::uint8_t>()); }, "at least one pixel");
  expect_error(
      ErrorCode::input,
      [&] {
        write_float_tiff(folder / "a.tif", Image<float>({2, 2}, 2));
      },
      "2 channels");
  expect_error(
      ErrorCode::input,
      [&] {
        write_tiff16(folder / "a.tif", Image<std::uint16_t>({2, 2}, 2));
      },
      "2 channels");
}

}  // namespace
}  // namespace malus
