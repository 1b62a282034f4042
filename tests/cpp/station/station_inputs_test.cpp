#include "io/temporary_folder.h"
#include "malus/io/sha256_internal.h"
#include "malus/station/station_inputs_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

class StationInputsTest : public testing::Test {
 protected:
  StationInputsTest() {
    for (const char* name : {"a.png", "b.png", "mask.png", "table.txt", "labels.png", "cloud.ply"})
      folder_.write(name, name);
    station_.file.path = folder_ / "station.toml";
    station_.file.polarized.images = {folder_ / "a.png"};
  }

  StationInputs::Values of(StationInputs::Part part) const {
    return StationInputs(station_, reference_, {}).of({part});
  }
  Json json(StationInputs::Part part) const { return of(part).parts; }

  TemporaryFolder folder_;
  Context context_;
  Station station_;
  std::optional<std::filesystem::path> reference_;
};

/// Sets a field to another value of its type.
struct Change {
  const TemporaryFolder& folder;

  void operator()(double& value) const { value += 1; }
  void operator()(int& value) const { value += 1; }
  void operator()(std::string& value) const { value += "2"; }
  void operator()(Response& value) const { value = Response::of("srgb").value(); }
  void operator()(std::vector<std::filesystem::path>& value) const { value.push_back(folder / "b.png"); }
  void operator()(std::optional<std::filesystem::path>& value) const { value = folder / "mask.png"; }
  template <NamedEnum T>
  void operator()(T& value) const {
    value = static_cast<T>(static_cast<int>(value) + 1);
  }
  template <class T>
  void operator()(std::optional<T>& value) const {
    value.emplace();
  }
  void operator()(std::vector<double>& value) const { value.push_back(1); }
  void operator()(std::vector<std::array<double, 2>>& value) const { value.push_back({1, 2}); }
};

TEST_F(StationInputsTest, EveryFieldOfASpecChangesItsValues) {
  const Station before = station_;
  const Json polarized = json(&StationInputs::polarized), optics = json(&StationInputs::optics);
  const Json metal = json(&StationInputs::metal);
  PolarizedSpec::fields(before.file.polarized, [&](std::string_view changed, const auto&...) {
    station_ = before;
    PolarizedSpec::fields(station_.file.polarized, [&](std::string_view name, auto& value, const auto&...) {
      if (name == changed) Change{folder_}(value);
    });
    EXPECT_NE(json(&StationInputs::polarized), polarized) << changed;
  });
  OpticsSpec::fields(before.file.optics, [&](std::string_view changed, const auto&...) {
    station_ = before;
    OpticsSpec::fields(station_.file.optics, [&](std::string_view name, auto& value, const auto&...) {
      if (name == changed) Change{folder_}(value);
    });
    // Only the fusion depends on the metal.
    const bool is_metal = changed == "metal";
    EXPECT_EQ(json(&StationInputs::optics) == optics, is_metal) << changed;
    EXPECT_EQ(json(&StationInputs::metal) == metal, !is_metal) << changed;
  });
}

TEST_F(StationInputsTest, FilesAreComparedByContent) {
  station_.file.polarized.mask = folder_ / "mask.png";
  station_.file.polarized.response = Response::of((folder_ / "table.txt").string()).value();
  const auto values = of(&StationInputs::polarized);
  EXPECT_EQ(values.hashes.size(), 3u);
  EXPECT_EQ(values.hashes.at("table.txt"), sha256_of_bytes("table.txt")) << "the name is relative to the station file";
  for (const char* name : {"a.png", "mask.png", "table.txt"}) {
    folder_.write(name, "other");
    EXPECT_NE(json(&StationInputs::polarized), values.parts) << name;
    folder_.write(name, name);
  }
  EXPECT_EQ(json(&StationInputs::polarized), values.parts) << "modification times do not count";
}

/// The process works in another folder while this object lives.
class WorkingFolder {
 public:
  explicit WorkingFolder(const std::filesystem::path& folder) { std::filesystem::current_path(folder); }
  ~WorkingFolder() { std::filesystem::current_path(before_); }
  WorkingFolder(const WorkingFolder&) = delete;
  WorkingFolder& operator=(const WorkingFolder&) = delete;

 private:
  std::filesystem::path before_ = std::filesystem::current_path();
};

TEST_F(StationInputsTest, AFileInTheCurrentFolderThatIsCalledAsAResponseDoesNotCount) {
  for (const char* name : {"linear", "srgb", "gamma:2.2"}) {
    folder_.write(name, "0 0\n1 1\n");
    station_.file.polarized.response = Response::of(name).value();
    const Json elsewhere = json(&StationInputs::polarized);
    const WorkingFolder here(folder_.path());
    const auto values = of(&StationInputs::polarized);
    EXPECT_EQ(values.parts, elsewhere) << name;
    EXPECT_EQ(values.hashes.size(), 1u) << name;
    EXPECT_EQ(Json::parse(describe_station_json(station_)).at("files").size(), 2u) << name;
  }
}

TEST_F(StationInputsTest, FoldersOfDevelopedImagesDoNotCount) {
  folder_.write("work/a.png", "a.png");
  const auto elsewhere = [&] {
    station_.file.polarized.images = {folder_ / "a.png"};
    const Json here = json(&StationInputs::polarized);
    station_.file.polarized.images = {folder_ / "work/a.png"};
    return here != json(&StationInputs::polarized);
  };
  EXPECT_TRUE(elsewhere());
  station_.developed_from = {folder_ / "b.png"};
  EXPECT_FALSE(elsewhere());
  EXPECT_EQ(of(&StationInputs::polarized).hashes.count("work/a.png"), 1u) << "the manifest names the file itself";
}

TEST_F(StationInputsTest, ModelFilesAreRecordedButOnlyTheCameraChangesTheValues) {
  station_.file.camera = CameraSpec{{LensModel::pinhole, {4, 3}, {5, 5, 2, 1}}, {}};
  station_.file.camera_files = {folder_ / "a.png"};
  const auto values = of(&StationInputs::camera);
  EXPECT_EQ(values.hashes.count("a.png"), 1u);
  folder_.write("a.png", "another image in the model");
  EXPECT_EQ(json(&StationInputs::camera), values.parts);
  station_.file.camera->pose.translation.x() = 1e-9;
  EXPECT_NE(json(&StationInputs::camera), values.parts);
}

TEST_F(StationInputsTest, EveryPartOfAPriorInMemoryChangesItsValues) {
  PointCloud cloud;
  cloud.points = {{1, 2, 3}};
  cloud.normals = {{0, 0, 1}};
  cloud.colors = {{1, 2, 3}};
  station_.prior = cloud;
  const auto values = of(&StationInputs::prior);
  EXPECT_EQ(values.hashes.count("prior normals"), 1u);
  cloud.normals[0].x() = 0.5F;
  station_.prior = cloud;
  EXPECT_NE(json(&StationInputs::prior), values.parts);
  cloud.normals = {{0, 0, 1}};
  cloud.colors[0][1] = 9;
  station_.prior = cloud;
  EXPECT_NE(json(&StationInputs::prior), values.parts);

  TriangleMesh mesh{cloud, {{0, 0, 0}}};
  station_.prior = mesh;
  const auto of_mesh = of(&StationInputs::prior);
  EXPECT_EQ(of_mesh.hashes.count("prior triangles"), 1u);
  mesh.triangles[0][2] = 1;
  station_.prior = mesh;
  EXPECT_NE(json(&StationInputs::prior), of_mesh.parts);
  mesh.vertices.points[0].y() = 9;
  station_.prior = mesh;
  EXPECT_NE(json(&StationInputs::prior), of_mesh.parts);

  // The same bytes as a raster of another shape.
  station_.prior = Image<float>({2, 3}, 1, 1.0F);
  const Json upright = json(&StationInputs::prior);
  station_.prior = Image<float>({3, 2}, 1, 1.0F);
  EXPECT_NE(json(&StationInputs::prior), upright);

  const Image<float> zeros({2, 3});
  const SweptDepth before{zeros, zeros, zeros, zeros, zeros};
  station_.prior = before;
  const Json swept = json(&StationInputs::prior);
  for (auto raster :
       {&SweptDepth::depth, &SweptDepth::sigma, &SweptDepth::shape, &SweptDepth::hull, &SweptDepth::hull_sigma}) {
    SweptDepth after = before;
    (after.*raster)(1, 1) = 1;
    station_.prior = after;
    EXPECT_NE(json(&StationInputs::prior), swept);
  }
}

TEST_F(StationInputsTest, ScaleAndStatedSigmaChangeTheValuesOfAnyPrior) {
  station_.prior = CloudFile{folder_ / "cloud.ply"};
  const Json before = json(&StationInputs::prior);
  station_.file.prior_scale = 2;
  const Json larger = json(&StationInputs::prior);
  station_.file.prior_sigma = 0.5;
  const Json stated = json(&StationInputs::prior);
  EXPECT_NE(larger, before);
  EXPECT_NE(stated, larger);
  station_.file.prior_sigma = 0.25;
  EXPECT_NE(json(&StationInputs::prior), stated);
}

TEST_F(StationInputsTest, LabelsInMemoryChangeItsValues) {
  const Json without = json(&StationInputs::optics);
  station_.labels = Mask({3, 2}, 1, std::uint8_t{1});
  const Json diffuse = json(&StationInputs::optics);
  EXPECT_NE(diffuse, without);
  (*station_.labels)(1, 1) = 2;
  EXPECT_NE(json(&StationInputs::optics), diffuse);
}

TEST_F(StationInputsTest, FilesThatPythonReadsAreRecorded) {
  station_.developed_from = {folder_ / "b.png"};
  EXPECT_EQ(of(&StationInputs::polarized).hashes.at("b.png"), sha256_of_bytes("b.png"));

  PointCloud cloud;
  cloud.points = {{1, 2, 3}};
  station_.prior = cloud;
  EXPECT_EQ(of(&StationInputs::prior).hashes.count("cloud.ply"), 0u);
  station_.file.prior = CloudFile{folder_ / "cloud.ply"};
  const auto scan = of(&StationInputs::prior);
  EXPECT_EQ(scan.hashes.at("cloud.ply"), sha256_of_bytes("cloud.ply"));
  folder_.write("cloud.ply", "other");
  EXPECT_NE(json(&StationInputs::prior), scan.parts);

  station_.file.prior.reset();
  station_.file.photos.emplace().folder = folder_ / "views";
  station_.photogrammetry = Photogrammetry{R"({"photogrammetry": {"files": {"a.jpg": "12ab"}}})", "{}", {}};
  station_.prior = SweptDepth{Image<float>({2, 3}), Image<float>({2, 3}), {}};
  const auto swept = of(&StationInputs::prior);
  EXPECT_EQ(swept.hashes.at("views/a.jpg"), "12ab");
  station_.photogrammetry->files = {{folder_ / "masks" / "a.png", "34cd"}};
  const auto masked = of(&StationInputs::prior);
  EXPECT_EQ(masked.hashes.at("masks/a.png"), "34cd");
  EXPECT_EQ(masked.parts, swept.parts) << "the hull that was made of the masks is compared, not they";
  station_.photogrammetry->figures_json = "{}";
  EXPECT_NE(json(&StationInputs::prior), swept.parts);
}

TEST_F(StationInputsTest, FilesThatChangeDuringARunAreRefused) {
  station_.prior = CloudFile{folder_ / "cloud.ply"};
  StationInputs inputs(station_, reference_, context_);
  const auto values = inputs.of({&StationInputs::prior});
  inputs.require_unchanged(values);
  folder_.write("cloud.ply", "cloud.plY");
  expect_error(
      ErrorCode::input, [&] { inputs.require_unchanged(values); }, "cloud.ply", "was changed while it was read");
}

TEST_F(StationInputsTest, NamesOfControlPointsChangeOnlyTheValuesOfRegions) {
  station_.file.control = {{"A", {1, 2, 3}, std::array{4.0, 5.0}, {}, true}};
  const Json prior = json(&StationInputs::prior), regions = json(&StationInputs::regions);
  station_.file.control[0].name = "B";
  EXPECT_EQ(json(&StationInputs::prior), prior);
  EXPECT_NE(json(&StationInputs::regions), regions);
}

TEST_F(StationInputsTest, KnownDistancesOfAPriorChangeTheValuesOfRegions) {
  const Json without = json(&StationInputs::regions);
  station_.file.scale_bars.emplace_back().distance = 10;
  station_.file.scale_errors = {0.01};
  const Json with = json(&StationInputs::regions);
  EXPECT_NE(with, without);
  station_.file.scale_errors = {0.02};
  EXPECT_NE(json(&StationInputs::regions), with);
}

TEST_F(StationInputsTest, ReferenceAndPhotogrammetryChangeTheValuesOfTheComparison) {
  const Json before = json(&StationInputs::comparison);
  reference_ = folder_ / "cloud.ply";
  const auto with_reference = of(&StationInputs::comparison);
  EXPECT_NE(with_reference.parts, before);
  EXPECT_EQ(with_reference.files.size(), 1u);
  station_.photogrammetry = Photogrammetry{R"({"scale": 2})", "{}", {}};
  EXPECT_NE(json(&StationInputs::comparison), with_reference.parts);
}

}  // namespace
}  // namespace malus
