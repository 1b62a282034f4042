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
  tag_gdal_nodata = 42113
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

/// The key directory and the two tags that its values may lie in.
class GeoKeys {
 public:
  void add_short(GeoKey key, std::uint16_t value) { add(key, 0, 1, value); }
  void add_double(GeoKey key, double value) {
    add(key, tag_geo_doubles, 1, static_cast<std::uint16_t>(doubles_.size()));
    doubles_.push_back(value);
  }
  void add_text(GeoKey key, const std::string& text) {
    add(key, tag_geo_ascii, static_cast<std::uint16_t>(text.size() + 1), static_cast<std::uint16_t>(ascii_.size()));
    ascii_ += text + "|";
  }

  void write(TIFF* tiff) {
    directory_[3] = static_cast<std::uint16_t>(directory_.size() / 4 - 1);
    TIFFSetField(tiff, tag_geo_keys, static_cast<int>(directory_.size()), directory_.data());
    if (!doubles_.empty()) TIFFSetField(tiff, tag_geo_doubles, static_cast<int>(doubles_.size()), doubles_.data());
    TIFFSetField(tiff, tag_geo_ascii, ascii_.c_str());
  }

 private:
  void add(GeoKey key, ttag_t place, std::uint16_t count, std::uint16_t value) {
    directory_.insert(directory_.end(), {key, static_cast<std::uint16_t>(place), count, value});
  }

  std::vector<std::uint16_t> directory_{1, 1, 1, 0};  // version, revision 1.1, number of keys
  std::vector<double> doubles_;
  std::string ascii_;
};

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

void write_reference(TIFF* tiff, const PlaneReference& reference) {
  add_fields(tiff);
  const double scale[] = {reference.pixel, reference.pixel, 0};
  // With pixels as areas the center of the top-left one is (0.5, 0.5).
  const double tiepoint[] = {0.5, 0.5, 0, 0, 0, 0};
  TIFFSetField(tiff, tag_pixel_scale, 3, scale);
  TIFFSetField(tiff, tag_tiepoint, 6, tiepoint);
  GeoKeys keys;
  keys.add_short(model_type, user_defined);
  keys.add_short(raster_type, pixel_is_area);
  // In the tag that holds the texts, a bar ends a text.
  std::string title = reference.title;
  std::ranges::replace(title, '|', ' ');
  keys.add_text(citation, title);
  const auto code = static_cast<std::uint16_t>(reference.unit.epsg != 0 ? reference.unit.epsg : user_defined);
  keys.add_short(projected_units, code);
  if (reference.unit.epsg == 0) keys.add_double(projected_unit_size, reference.unit.metres);
  keys.add_short(vertical_units, code);
  keys.write(tiff);
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
