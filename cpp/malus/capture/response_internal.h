#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/station_spec.h"

namespace malus {

/// How encoded intensities (0 = black level, 1 = white level) become linear ones.
struct ResponseCurve {
  using Kind = Response::Kind;

  Kind kind = Kind::linear;
  double exponent = 1;          ///< gamma: linear = encoded ^ exponent
  std::vector<double> encoded;  ///< table: strictly increasing; DN, or [0, 1] when no value exceeds 1
  std::vector<double> linear;   ///< table: not decreasing, last value 1

  /// True when linear = encoded; values below the black level then stay negative, so that dark means stay unbiased.
  bool is_identity() const { return kind == Kind::linear || (kind == Kind::gamma && exponent == 1); }
  /// True for a table of digital numbers (DN).
  bool is_of_numbers() const { return kind == Kind::table && encoded.back() > 1; }
  /// Linear intensity of an encoded one. sRGB: IEC 61966-2-1. Tables are interpolated linearly and held at their ends.
  double linearize(double value) const;
  /// d linear / d encoded, by a central difference of one 8-bit step.
  double slope(double value) const;
};

/// Curve of a response. `where` names file and field in messages. Throws an input error for a lookup table that does
/// not exist, which lists what else was expected, and those of read_response_table.
ResponseCurve response_curve(const Response& response, const std::string& where);

/// Lookup table from a text file of at most 4 MB and 65536 rows; '#' starts a comment, columns are separated by blanks,
/// commas or semicolons. Two columns: encoded (DN, or [0, 1] when none exceeds 1) and linear intensity in any unit
/// (scaled so that the last is 1). One column: linear intensities of evenly spaced encoded values from black to white.
/// Throws an input error naming file and line.
ResponseCurve read_response_table(const std::filesystem::path& path);

/// Black, white and saturation levels of digital numbers.
struct Levels {
  double black_dn = 0;
  double white_dn = 1;
  double dn_step = 1;         ///< one digital number in units of white − black; 0 for floating-point files
  double saturation = 0.995;  ///< encoded intensity from which a pixel counts as saturated
};

/// Levels of a raw image: white from the station file, else the last number of a table of DN, beyond which all numbers
/// count alike, else the file's full scale. Input error unless white > black, and for a floating-point image of digital
/// numbers without a stated white level.
Levels levels_of(const RawImage& raw, const PolarizedSpec& spec, const ResponseCurve& curve, double saturation,
                 const std::string& name);

/// Input error for a table of DN that are not those of the image: the table ends far from the white level, or the image
/// is in [0, 1]. All intensities would be wrong, most of them black or all alike.
void require_numbers_of_table(const RawImage& raw, const Levels& levels, const ResponseCurve& curve,
                              const std::string& name);

/// Question whether the white level is right; empty if there is no doubt. What the sensor clipped does not count as
/// saturated if its largest number lies below the white level: 1023, 4095 or 16383 in a file of 16 bits, of a sensor of
/// fewer bits, or another one that far more pixels have than the numbers just below it.
std::string doubt_of_white_level(const RawImage& raw, const Levels& levels, const std::string& name);

/// Weights (R, G, B) that make one channel of three: channel_weights if given (scaled to sum 1), else `channel`:
/// "red", "green", "blue", "mean", or "luminance" (Rec. 709: 0.2126, 0.7152, 0.0722 on linear values).
/// Input error if the weights are negative, not finite or all zero.
std::array<double, 3> channel_weights(const PolarizedSpec& spec);

/// One image in linear intensities, [0, 1] of the white level.
struct LinearImage {
  Image<float> intensity;  ///< 1 channel
  Mask saturated;          ///< 255 where any channel with a weight is at the white level
  bool color = false;      ///< whether the image had three channels that differ somewhere
};

/// Subtracts black, divides by white − black, applies the curve and combines the channels (after linearization).
/// An RGB file whose three channels are equal everywhere is taken as monochrome. Input error naming `name` when the
/// image holds values that are not finite or has neither 1 nor 3 channels.
LinearImage linearize(RawImage raw, const ResponseCurve& curve, const Levels& levels,
                      const std::array<double, 3>& weights, const std::string& name, const Context& context);

/// The three linear channels of a color image. Input error naming `name` when it holds values that are not finite.
Image<float> linearize_color(const RawImage& raw, const ResponseCurve& curve, const Levels& levels,
                             const std::string& name, const Context& context);

}  // namespace malus
