#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "malus/options/capture_options.h"
#include "malus/options/fusion_options.h"
#include "malus/options/height_options.h"
#include "malus/options/polarization_options.h"
#include "malus/options/prior_options.h"
#include "malus/options/surface_options.h"

namespace malus {

/// Options of every step. The sections' fields are listed once, in each step's own options struct.
struct Options {
  Fusion fusion = Fusion::refined;
  CaptureOptions capture;
  DecomposeOptions polarization;
  PolarizerOptions polarizer;
  PhotosOptions photos;
  SweepOptions sweep;
  PriorOptions prior;
  EvidenceOptions evidence;
  ReflectionOptions reflection;
  LightOptions light;
  HeightOptions height;
  GridFusionOptions grid;
  OptimizeOptions optimize;
  RefineOptions refine;
  SurfaceOptions surface;
  AssessOptions assess;

  template <class Self, class Visitor>
  static void sections(Self& self, Visitor&& visit) {
    visit("capture", self.capture);
    visit("polarization", self.polarization);
    visit("polarizer", self.polarizer);
    visit("photos", self.photos);
    visit("sweep", self.sweep);
    visit("prior", self.prior);
    visit("evidence", self.evidence);
    visit("reflection", self.reflection);
    visit("light", self.light);
    visit("height", self.height);
    visit("grid", self.grid);
    visit("optimize", self.optimize);
    visit("refine", self.refine);
    visit("surface", self.surface);
    visit("assess", self.assess);
  }

  /// Throws an input error naming section, field, value and bound.
  void validate() const;
};

/// All values as JSON, {"fusion": …, "section": {"key": value}}.
std::string options_to_json(const Options& options);
/// The options with the values of such a JSON object replaced; options that it does not name keep their value. Unknown
/// sections and keys, wrong types and values out of range are input errors that name them.
Options options_from_json(const Options& options, std::string_view json);
/// Applies one assignment as on the command line, "section.key=value" or "fusion=grid".
void set_option(Options& options, std::string_view assignment);
/// The options with the values of a TOML file replaced; the file has one table per section.
Options options_from_file(const Options& options, const std::filesystem::path& path);
/// Every option with type, default, range and meaning, as JSON {"section": {"key": {"type", "default", "min", "max",
/// "doc"}}}.
std::string option_schema_json();

}  // namespace malus
