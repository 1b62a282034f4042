#include <tiffio.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <string_view>
#include <utility>

#include "malus/io/atomic_file_internal.h"
#include "malus/io/geotiff_file_internal.h"
#include "malus/io/image_codecs_internal.h"

namespace malus {
namespace {

// Tags of GeoTIFF 1.1 (OGC 19-008r4) and of GDAL, which libtiff does not know by itself.
enum : ttag_t {
  tag_pixel_scale = 33550,
  tag_tiepoint = 33922,
  tag_geo_keys = 34735,
  tag_geo_doubles = 34736,
  tag_geo_ascii = 34737,
  tag_gdal_metadata = 42112,
  tag_gdal_nodata = codecs::gdal_nodata_tag
};

enum GeoKey : std::uint16_t {
  model_type = 1024,
  raster_type = 1025,
  citation = 1026,
  projected_units = 3076,
  projected_unit_size = 3077,
  vertical_units = 4099
};
constexpr std::uint16_t user_defined = 32767, pixel_is_area = 1;

/// Text that is valid in XML and in a GeoTIFF citation.
std::string escaped(std::string_view text) {
  using Entity = std::pair<char, std::string_view>;
  constexpr std::array<Entity, 4> entities{{{'&', "&amp;"}, {'<', "&lt;"}, {'>', "&gt;"}, {'"', "&quot;"}}};
  std::string out;
  for (const char c : text) {
    const auto entity = std::ranges::find(entities, c, &Entity::first);
    if (entity != entities.end()) {
      out += entity->second;
    } else {
      out += c;
    }
  }
  return out;
}

std::string metadata_xml(const PlaneReference& reference) {
  std::string xml = "<GDALMetadata>\n";
  for (const auto& [name, value] : reference.metadata)
    xml += "  <Item name=\"" + escaped(name) + "\">" + escaped(value) + "</Item>\n";
  return xml + "  <Item name=\"UNITTYPE\" sample=\"0\" role=\"unittype\">" + std::string(reference.unit.name) +
         "</Item>\n</GDALMetadata>\n";
}

void add_fields(TIFF* tiff) {
  constexpr short any = TIFF_VARIABLE;
  static char names[][20] = {"ModelPixelScaleTag", "ModelTiepointTag", "GeoKeyDirectoryTag", "GeoDoubleParamsTag",
                             "GeoASCIIParamsTag",  "GDALMetadata",     "GDALNoDataValue"};
  static const TIFFFieldInfo fields[] = {
      {tag_pixel_scale, any, any, TIFF_DOUBLE, FIELD_CUSTOM, 1, 1, names[0]},
      {tag_tiepoint, any, any, TIFF_DOUBLE, FIELD_CUSTOM, 1, 1, names[1]},
      {tag_geo_keys, any, any, TIFF_SHORT, FIELD_CUSTOM, 1, 1, names[2]},
      {tag_geo_doubles, any, any, TIFF_DOUBLE, FIELD_CUSTOM, 1, 1, names[3]},
      {tag_geo_ascii, any, any, TIFF_ASCII, FIELD_CUSTOM, 1, 0, names[4]},
      {tag_gdal_metadata, any, any, TIFF_ASCII, FIELD_CUSTOM, 1, 0, names[5]},
      {tag_gdal_nodata, any, any, TIFF_ASCII, FIELD_CUSTOM, 1, 0, names[6]},
  };
  TIFFMergeFieldInfo(tiff, fields, static_cast<std::uint32_t>(std::size(fields)));
}

void write_geo_keys(TIFF* tiff, const PlaneReference& reference) {
  // In the tag that holds the texts, a bar ends a text.
  std::string title = reference.title;
  std::ranges::replace(title, '|', ' ');
  title += '|';
  const bool has_code = reference.unit.epsg != 0;
  const auto unit = static_cast<std::uint16_t>(has_code ? reference.unit.epsg : user_defined);
  const auto length = static_cast<std::uint16_t>(title.size());
  // Key, tag that holds its value (0 = the row itself), number of values, and the value or its place in the tag. The
  // first row is the version, the revision 1.1 and the number of keys, which follow in increasing order.
  std::vector<std::array<std::uint16_t, 4>> rows{{1, 1, 1, 0},
                                                 {model_type, 0, 1, user_defined},
                                                 {raster_type, 0, 1, pixel_is_area},
                                                 {citation, tag_geo_ascii, length, 0},
                                                 {projected_units, 0, 1, unit}};
  if (!has_code) rows.push_back({projected_unit_size, tag_geo_doubles, 1, 0});
  rows.push_back({vertical_units, 0, 1, unit});
  rows.front()[3] = static_cast<std::uint16_t>(rows.size() - 1);
  TIFFSetField(tiff, tag_geo_keys, static_cast<int>(4 * rows.size()), rows.front().data());
  if (!has_code) TIFFSetField(tiff, tag_geo_doubles, 1, &reference.unit.meters);
  TIFFSetField(tiff, tag_geo_ascii, title.c_str());
}

void write_reference(TIFF* tiff, const PlaneReference& reference) {
  add_fields(tiff);
  const double scale[] = {reference.pixel, reference.pixel, 0};
  // With pixels as areas the center of the top-left one is (0.5, 0.5).
  const double tiepoint[] = {0.5, 0.5, 0, 0, 0, 0};
  TIFFSetField(tiff, tag_pixel_scale, 3, scale);
  TIFFSetField(tiff, tag_tiepoint, 6, tiepoint);
  write_geo_keys(tiff, reference);
  TIFFSetField(tiff, tag_gdal_metadata, metadata_xml(reference).c_str());
  TIFFSetField(tiff, tag_gdal_nodata, "nan");
}

}  // namespace

void write_geotiff(const std::filesystem::path& path, const Image<float>& image, const PlaneReference& reference) {
  if (image.channels() != 1) {
    throw input_error("cannot write " + path.string() + ": " + std::to_string(image.channels()) +
                      " channels, expected 1");
  }
  AtomicFile file(path);
  codecs::encode_float_tiff(file, image, [&](TIFF* tiff) { write_reference(tiff, reference); });
  file.commit();
}

}  // namespace malus
