#include <algorithm>

#include "malus/station/step_functions_internal.h"

namespace malus {
namespace {

using Of = StationInputs;

bool by_grid(const Station&, const Options& options) {
  return options.fusion == Fusion::grid;
}
bool by_refinement(const Station&, const Options& options) {
  return options.fusion == Fusion::refined;
}
bool has_prior(const Station& station, const Options&) {
  return station.has_prior();
}
bool is_photographed(const Station& station, const Options&) {
  return std::holds_alternative<SweptDepth>(station.prior);
}
bool is_assessed(const Options& options) {
  return options.assess.polarization_height;
}

std::vector<Step> steps_before_fusion() {
  return {
      step({.name = "polarization",
            .does = "intensity, degree and phase from the images",
            .options = {"capture", "polarization", "polarizer"},
            .station = {&Of::polarized, &Of::lens},
            .leaves = {"polarization/measured/unpolarized.tif", "polarization/measured/degree.tif",
                       "polarization/measured/phase.tif", "polarization/residual.tif", "polarization/valid.png"},
            .may_leave = {"polarization/variance_factor.tif", "polarization/color.tif", "polarization/scene.tif"},
            .cost = polarization_cost},
           measure_polarization),
      step_by_python({.name = "photos",
                      .does = "the photos' cameras and the station's among them",
                      .serves = "prior",
                      .applies = is_photographed}),
      step_by_python({.name = "sweep",
                      .does = "depth of the station's view from the photos",
                      .serves = "prior",
                      .applies = is_photographed}),
      step({.name = "prior",
            .does = "the coarse surface in the polarized view",
            .options = {"prior"},
            .station = {&Of::prior, &Of::camera},
            .leaves = {"prior/depth.tif", "prior/sigma.tif"},
            .may_leave = {"prior/points.png"},
            .cost = prior_cost,
            .applies = has_prior},
           make_prior),
      step({.name = "polarizer",
            .does = "the polarizer's scale, corrected by the surface",
            .options = {"polarizer", "light"},
            .station = {&Of::polarized, &Of::optics},
            .leaves = {"polarization/unpolarized.tif", "polarization/degree.tif", "polarization/phase.tif"},
            .cost = polarizer_cost},
           calibrate_polarization),
      step({.name = "evidence",
            .does = "whether images, prior and polarizer contradict each other",
            .options = {"evidence"},
            .station = {&Of::prior, &Of::camera, &Of::title},
            .leaves = {"evidence/findings.json"},
            .cost = evidence_cost},
           check_inputs),
      step({.name = "zenith",
            .does = "whether each pixel is matte or mirrors, and its slope by the degree of polarization",
            .options = {"reflection"},
            .station = {&Of::optics, &Of::lens},
            .leaves = {"polarization/zenith.tif", "polarization/label.png", "polarization/clamped.png"},
            .cost = zenith_cost,
            .on_its_own = is_assessed},
           find_zenith),
      step({.name = "height",
            .does = "height from polarization alone",
            .options = {"light", "height"},
            .station = {&Of::optics, &Of::lens},
            .leaves = {"height/height.tif"},
            .cost = height_cost,
            .on_its_own = is_assessed},
           make_height),
  };
}

std::vector<Step> steps_from_fusion_on() {
  return {
      step(
          {.name = "fuse",
           .does = "the paper's transfer of polarization detail onto the prior",
           .options = {"fusion", "grid", "optimize"},
           .station = {&Of::optics, &Of::metal},
           .leaves = {"fused/depth.tif", "fused/normals.tif", "fused/sigma.tif", "fused/camera.txt", "fused/image.txt"},
           .cost = grid_cost,
           .applies = by_grid},
          fuse_by_grid),
      step({.name = "fuse",
            .does = "the surface that suits the coarse one and the polarization best",
            .options = {"fusion", "refine"},
            .station = {&Of::optics, &Of::metal},
            .leaves = {"fused/depth.tif", "fused/normals.tif", "fused/sigma.tif", "fused/camera.txt", "fused/image.txt",
                       "fused/label.png", "fused/confidence.png", "fused/mirrored.tif", "fused/refinement.json"},
            .may_leave = {"fused/trust.png"},
            .cost = refined_cost,
            .applies = by_refinement},
           fuse_by_refinement),
      step({.name = "mesh",
            .does = "mesh in true size, mesh with its picture, and elevation model",
            .options = {"surface"},
            .station = {&Of::title, &Of::object},
            .leaves = {"fused/surface.ply", "fused/surface.glb"},
            .may_leave = {"fused/dem.tif"},
            .cost = mesh_cost},
           write_mesh),
      step({.name = "assess",
            .does = "patches, profiles, comparison with a reference",
            .options = {"assess"},
            .station = {&Of::title, &Of::object, &Of::regions, &Of::comparison},
            .leaves = {"quality.json"},
            .may_leave = {"fused/reference_distance.tif"},
            .cost = assess_cost},
           make_quality),
  };
}

std::vector<Step> steps_by_python() {
  return {
      step_by_python<FusedSurface, QualityReport>({.name = "m3c2",
                                                   .does = "comparison with a reference by M3C2",
                                                   .leaves = {"m3c2.json", "fused/m3c2_distance.tif"}}),
      step_by_python<FusedSurface, QualityReport>({.name = "paper",
                                                   .does = "plates and tables of the paper, for print",
                                                   .leaves = {"paper/table_1.csv", "paper/table_2.csv"}}),
      step_by_python<FusedSurface, QualityReport, Warnings>(
          {.name = "report", .does = "every figure on one page", .leaves = {"report/index.html"}}),
  };
}

std::vector<Step> make_table() {
  std::vector<Step> table = steps_before_fusion();
  for (const auto& more : {steps_from_fusion_on(), steps_by_python()})
    table.insert(table.end(), more.begin(), more.end());
  return table;
}

}  // namespace

bool Step::reads_type(std::type_index type) const {
  return std::ranges::find(reads, type, &Read::type) != reads.end();
}

bool Step::makes_type(std::type_index type) const {
  return std::ranges::find(makes, type, &Part::type) != makes.end();
}

bool uses(const Step& reader, const Step& maker) {
  return reader.reads_type(typeid(Warnings)) ||
         std::ranges::any_of(maker.makes, [&](const Part& part) { return reader.reads_type(part.type); });
}

const std::vector<Step>& step_table() {
  static const std::vector<Step> table = make_table();
  return table;
}

std::vector<const Step*> steps_of_run(const std::vector<Step>& table, const Station& station, const Options& options,
                                      const std::optional<std::string>& until) {
  // The steps for which the station has all inputs.
  std::vector<const Step*> possible;
  const auto can_be_read = [&](const Read& read) {
    return !read.is_required || read.type == typeid(Warnings) ||
           std::ranges::any_of(possible, [&](const Step* maker) { return maker->makes_type(read.type); });
  };
  for (const Step& step : table) {
    if (step.run && step.applies(station, options) && std::ranges::all_of(step.reads, can_be_read))
      possible.push_back(&step);
  }
  // From the last step back: those that are wanted for themselves or by a later step.
  std::vector<const Step*> wanted;
  std::ranges::reverse(possible);
  for (const Step* step : possible) {
    const bool for_itself = until ? step->name == *until : step->on_its_own(options);
    const bool for_another = std::ranges::any_of(wanted, [&](const Step* reader) {
      return std::ranges::any_of(reader->reads, [&](const Read& read) {
        if (read.type == typeid(Warnings)) return step->on_its_own(options);
        return step->makes_type(read.type) && (read.is_required || step->on_its_own(options));
      });
    });
    if (for_itself || for_another) wanted.insert(wanted.begin(), step);
  }
  return wanted;
}

std::vector<const Step*> planned_steps(const std::vector<Step>& table, const Station& station, const Options& options,
                                       const std::optional<std::string>& until) {
  const std::vector<const Step*> run = steps_of_run(table, station, options, until);
  const auto runs = [&run](const std::string& name) { return std::ranges::find(run, name, &Step::name) != run.end(); };
  std::vector<const Step*> planned;
  for (const Step& step : table) {
    const bool is_run = std::ranges::find(run, &step) != run.end();
    if (is_run || (runs(step.serves) && step.applies(station, options))) planned.push_back(&step);
  }
  return planned;
}

std::vector<std::string> files_of(const std::vector<Step>& table, const std::string& name) {
  std::vector<std::string> files;
  for (const Step& step : table) {
    if (step.name != name) continue;
    files.insert(files.end(), step.leaves.begin(), step.leaves.end());
    files.insert(files.end(), step.may_leave.begin(), step.may_leave.end());
  }
  return files;
}

}  // namespace malus
