#include <Eigen/Geometry>
#include <limits>

#include "io/temporary_folder.h"
#include "malus/io/input_file_internal.h"
#include "malus/station/kept_results_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();

Image<float> raster(float start, int channels = 1) {
  Image<float> image({5, 3}, channels);
  for (std::size_t i = 0; i < image.count(); ++i) image[i] = start + 0.1F * static_cast<float>(i);
  return image;
}

Image<std::uint8_t> labels(std::uint8_t value) {
  return {{5, 3}, 1, value};
}

const Pinhole camera{{5, 3}, 100.25, 101, 2.5, 1.125};
const Pose pose{Eigen::AngleAxisd(0.3, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix(), {1, -2, 0.1}};

/// Record and files that a workspace keeps of one result.
struct Kept {
  Workspace::Record record;
  std::map<std::string, std::string> files;
};

template <class T>
Kept kept(T& result) {
  const TemporaryFolder folder;
  StepFiles files;
  Json notes = Json::object();
  Keeper keeper(files, notes);
  keep(result, keeper);
  Kept kept;
  for (const std::string& name : files.write(folder.path(), {})) {
    kept.files[name] = read_file(folder / name, "file");
    kept.record.outputs.push_back({name, 0, ""});
  }
  // As in the manifest: written as text, with sorted keys.
  kept.record.notes = Json(nlohmann::json::parse(nlohmann::json(notes).dump()));
  return kept;
}

template <class T>
T read_back(const Kept& kept, const std::shared_ptr<const void>& other = nullptr) {
  const TemporaryFolder folder;
  for (const auto& [name, bytes] : kept.files) folder.write(name, bytes);
  T result;
  Keeper keeper(folder.path(), kept.record, [&](std::type_index) { return other; });
  keep(result, keeper);
  return result;
}

/// Keeps the result in a workspace and reads it back. Keeping the copy must give the same files and notes.
template <class T>
T expect_kept(T result, const std::shared_ptr<const void>& other = nullptr) {
  const Kept first = kept(result);
  T back = read_back<T>(first, other);
  const Kept second = kept(back);
  EXPECT_EQ(first.files, second.files);
  EXPECT_EQ(first.record.notes, second.record.notes);
  return back;
}

PolarizationState state() {
  PolarizationState state;
  state.i_un = raster(0.1F);
  state.rho = raster(0.2F);
  state.phi = raster(0.3F);
  state.residual = raster(1);
  state.residual(1, 1) = std::numeric_limits<float>::quiet_NaN();
  state.valid = labels(255);
  state.angles_rad = {0, 0.1, 2};
  state.exposures = {1, 2, 1};
  state.noise = {12345, 6.5, 1e-4, 7};
  state.weighting = FitWeighting::noise;
  return state;
}

MeasuredPolarization measured() {
  PolarizerFit fit;
  fit.angles_rad = {0, 0.1, 2};
  fit.gains = {1, 1.01, 0.99};
  fit.image_information = Eigen::VectorXd::LinSpaced(6, 0.1, 1) * Eigen::RowVectorXd::LinSpaced(6, -1, 3);
  fit.nominal_weight = Eigen::VectorXd::LinSpaced(6, 0.3, 1);
  fit.residual_before = 2;
  fit.residual_after = nan;
  fit.pixels = 1000;
  fit.largest_gain_change = 0.01;
  return {std::make_shared<PolarizationState>(state()), fit, true, {{3, 2, {0, 45.5}, {0.1, 0.2}}}};
}

TEST(KeptResults, MeasuredPolarizationIsReadBackUnchanged) {
  const MeasuredPolarization back = expect_kept(measured());
  EXPECT_EQ(back.state->weighting, FitWeighting::noise);
  EXPECT_EQ(back.state->i_un, state().i_un);
  EXPECT_TRUE(back.state->variance_factor.empty());
  EXPECT_TRUE(back.polarizer_fitted);
  EXPECT_EQ(back.curves.at(0).intensities, (std::vector<double>{0.1, 0.2}));
  EXPECT_EQ(back.polarizer.largest_gain_change, 0.01);
  EXPECT_EQ(back.polarizer.image_information, measured().polarizer.image_information);

  auto interpolated = std::make_shared<PolarizationState>(state());
  interpolated->variance_factor = raster(2);
  EXPECT_EQ(expect_kept(MeasuredPolarization{interpolated, {}, false}).state->variance_factor, raster(2));
}

TEST(KeptResults, CalibratedPolarizationSharesUnchangedRastersWithTheMeasuredOne) {
  const auto from = std::make_shared<MeasuredPolarization>(measured());
  CalibratedPolarization as_measured{from->state, {}};
  EXPECT_EQ(expect_kept(as_measured, from).state, from->state) << "without a correction nothing is copied";

  auto turned = std::make_shared<PolarizationState>(state());
  turned->phi = raster(0.5F);
  turned->angles_rad = {0.2, 0.3, 2.2};
  CalibratedPolarization corrected{turned, {}};
  corrected.polarizer.from_surface = true;
  corrected.polarizer.warnings = {"turned"};
  const CalibratedPolarization back = expect_kept(corrected, from);
  EXPECT_EQ(back.state->phi, turned->phi);
  EXPECT_EQ(back.state->angles_rad, turned->angles_rad);
  EXPECT_EQ(back.state->valid, from->state->valid);
  EXPECT_EQ(back.state->noise.read_noise_e, 6.5);
  EXPECT_EQ(back.state->weighting, FitWeighting::noise);
  EXPECT_EQ(from->state->phi, state().phi) << "the measured phase is unchanged";
}

TEST(KeptResults, ViewColorAndSceneAreReadBackUnchanged) {
  const StationView view = expect_kept(StationView{camera, {0, 0.5, nan}});
  EXPECT_EQ(view.camera.size, camera.size);
  EXPECT_EQ(view.camera.cy, camera.cy);
  EXPECT_TRUE(std::isnan(view.registration_rms_px[2]));
  EXPECT_EQ(expect_kept(ObjectColor{raster(0, 3)}).image, raster(0, 3));
  EXPECT_TRUE(expect_kept(ObjectColor{}).image.empty());
  EXPECT_EQ(expect_kept(Scene{raster(4)}).image, raster(4));
}

TEST(KeptResults, InputEvidenceKeepsItsFindings) {
  const InputEvidence back =
      expect_kept(InputEvidence{{{Check::misfits, Severity::caution, "many", "look", {{"misfit_fraction", 0.25}}}}});
  ASSERT_EQ(back.findings.size(), 1u);
  EXPECT_EQ(back.findings[0].severity, Severity::caution);
  EXPECT_EQ(back.findings[0].figures[0].second, 0.25);
}

TEST(KeptResults, SurfacesAreReadBackUnchanged) {
  const DepthPrior prior = expect_kept(DepthPrior{raster(500), raster(1), camera, pose, 10, 9, nan, 3, 4, true, 0.5});
  EXPECT_EQ(prior.pose.rotation, pose.rotation) << "doubles are kept exactly";
  EXPECT_TRUE(prior.shares_windows);
  EXPECT_EQ(prior.filled_fraction, 0.5);
  const ReflectionMap reflection = expect_kept(ReflectionMap{labels(2), raster(0.5F), 1.7, 0.25, 0.125});
  EXPECT_EQ(reflection.refractive_index, 1.7);
  EXPECT_EQ(reflection.specular_share, 0.25);
  EXPECT_EQ(expect_kept(PriorPoints{labels(128)}).map, labels(128));
  EXPECT_TRUE(expect_kept(PriorPoints{}).map.empty());
  EXPECT_EQ(expect_kept(ClampedZeniths{labels(255), 0.5}).fraction, 0.5);
  HeightMap height;
  height.height = raster(-1);
  height.perspective = false;
  height.light = {0.1, 0.2, 0.3, nan};
  height.status = HeightStatus::converged;
  height.unknowns = 15;
  height.over_prior = 14.5;
  height.unsolved_tiles = 2;
  height.solver_bytes = 1e9;
  EXPECT_EQ(expect_kept(height).light.head<3>(), height.light.head<3>());
  EXPECT_EQ(expect_kept(height).over_prior, 14.5);
  EXPECT_EQ(expect_kept(height).unsolved_tiles, 2);
  EXPECT_EQ(expect_kept(height).solver_bytes, 1e9);
  const FusedSurface surface = expect_kept(FusedSurface{raster(500),
                                                        raster(0, 3),
                                                        raster(1),
                                                        camera,
                                                        pose,
                                                        Fusion::grid,
                                                        FusionStatus::converged,
                                                        {"one"},
                                                        {ConfidenceLevel::partial, {"half of it"}}});
  EXPECT_EQ(surface.normals.channels(), 3);
  EXPECT_EQ(surface.confidence.level, ConfidenceLevel::partial);
  EXPECT_EQ(surface.confidence.reasons.size(), 1u);
  EXPECT_EQ(surface.warnings.size(), 1u);
  const RefinementFindings findings{"{\"b\": 1, \"a\": 2}\n", labels(1), labels(200), labels(7), raster(0.5F)};
  EXPECT_EQ(expect_kept(findings).report_json, "{\"b\": 1, \"a\": 2}\n");
}

TEST(KeptResults, OnlyFilesThatTheStepLeftAreRead) {
  ObjectColor color{raster(0, 3)};
  Kept stale = kept(color);
  stale.record.outputs.clear();
  EXPECT_TRUE(read_back<ObjectColor>(stale).image.empty());
}

TEST(KeptResults, RastersOfOneResultHaveOneSize) {
  MeasuredPolarization good = measured();
  Kept wrong = kept(good);
  ObjectColor large{Image<float>({9, 9})};
  wrong.files["polarization/residual.tif"] = kept(large).files.begin()->second;
  expect_error(
      ErrorCode::input, [&] { read_back<MeasuredPolarization>(wrong); }, "residual.tif", "9 x 9", "5 x 3");
}

}  // namespace
}  // namespace malus
