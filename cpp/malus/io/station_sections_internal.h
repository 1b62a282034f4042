#pragma once

// Private to the io room: one reader a section of the station file, in the order in which they are called; each is in
// the source named after its section. `document` is the whole file. All throw ErrorCode::input with file, line, field,
// value and what was expected.

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "malus/io/given_station_internal.h"
#include "malus/io/station_spec.h"
#include "malus/io/toml_library_internal.h"
#include "malus/io/toml_table_internal.h"

namespace malus {

/// [polarized], which every station has. `given`: the images in memory, whose files are then no keys; nullptr = all
/// data are in files. Throws ErrorCode::data for fewer than three distinct polarizer angles modulo 180°, and for fewer
/// than five images whose angles are to be found.
PolarizedSpec read_polarized(const TomlTable& document, const GivenInMemory* given);

/// [optics]; the defaults without it.
OpticsSpec read_optics(const TomlTable& document, const GivenInMemory* given);

/// [photos]; nothing without it.
std::optional<PhotosSpec> photos_in(const TomlTable& document);

/// [prior]: sets file or shape, and sigma. No surface need be named if the surface itself is in memory.
void read_prior(const TomlTable& document, bool in_memory, StationFile& station);

/// The shape in a table with one of the keys `plane`, `sphere` and `cylinder` of [prior].
Shape read_shape_table(const toml::table& root);

/// [[control]]: all control points. They define the frame of [photos] if the surface comes from these, else the pose of
/// the polarized image's camera.
std::vector<ControlPoint> read_control(const TomlTable& document, const StationFile& station);

/// Throws unless the control points lie in the image.
void require_control_in_image(const TomlTable& document, const StationFile& station, Size size);

/// [camera]: sets the lens, or the camera with its pose, which may come from the control points. `images`: size of the
/// polarized images, as far as it is known. Nothing changes without the section.
void read_camera(const TomlTable& document, const std::optional<Size>& images, StationFile& station);

/// The lens that another section, such as [photos], has as its table `camera`; nothing without it.
std::optional<LensCamera> lens_in(const TomlTable& section);

/// Size of the polarized images; nothing for RAW files, whose size is known only after development, and for images in
/// memory, whose size is that of the camera. `where` names the images in messages.
std::optional<Size> size_of_images(const StationFile& station, const std::string& where);

/// Size of images without a known one of their own: that of the camera, if it is stated.
Size size_of_camera(const StationFile& station);

/// [[scale]]: all bars; the bars of a given prior scale the prior and the camera's position. `has_prior`: in a file or
/// in memory.
void read_scale_bars(const TomlTable& document, bool has_prior, StationFile& station);

/// [[patch]] and [[profile]], which must lie in the polarized image of this size.
void read_regions(const TomlTable& document, Size size, StationFile& station);

/// All sections: as read_station_file, but from tables that are parsed already. `path`: the file, whose folder relative
/// paths start at. `given`: nullptr = all data are in files; otherwise the tables name no images, mask or camera.
/// `shared_photos`: those of tables without [photos].
StationFile read_station_tables(const toml::table& root, const std::filesystem::path& path, const GivenInMemory* given,
                                const std::optional<PhotosSpec>& shared_photos = std::nullopt);

}  // namespace malus
