#include <cmath>
#include <numbers>

#include "malus/io/colmap_model_internal.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/polarized_files_internal.h"
#include "malus/io/station_file_internal.h"
#include "shared_data.h"
#include "temporary_folder.h"
#include "thrown_error.h"

namespace malus {
namespace {

/// A complete small station file; tests replace single sections.
struct Sections {
  std::string station = "[station]\nname = \"test\"\n";
  std::string polarized =
      "[polarized]\nimages = [\"pol/a_000.png\", \"pol/a_045.png\", \"pol/a_090.png\"]\nangles_deg = [0, 45, 90]\n";
  std::string camera =
      "[camera]\nmodel = \"PINHOLE\"\nwidth = 12\nheight = 8\nparams = [100, 101, 6.0, 4.5]\nqvec = [1, 0, 0, 0]\ntvec "
      "= [0, 0, 50]\n";
  std::string prior = "[prior]\ncloud = \"cloud.ply\"\n";
  std::string rest;

  std::string text() const { return station + polarized + camera + prior + rest; }
};

class StationFileTest : public testing::Test {
 protected:
  StationFileTest() {
    std::filesystem::create_directories(folder_ / "pol");
    std::filesystem::create_directories(folder_ / "views");
    for (const std::string name : {"a_000", "a_045", "a_090"}) {
      write_png(folder_ / ("pol/" + name + ".png"), Image<std::uint8_t>({12, 8}));
    }
    for (const std::string name : {"cloud.ply", "depth.tif", "views/1.jpg", "views/2.jpg", "mask.png", "label.png"}) {
      folder_.write(name, "x");
    }
  }
  StationFile read(const Sections& sections) const {
    return read_station_file(folder_.write("station.toml", sections.text()));
  }
  template <class... Parts>
  void rejects(const Sections& sections, const Parts&... parts) const {
    expect_error(
        ErrorCode::input, [&] { read(sections); }, "station.toml", parts...);
  }
  /// Expects an error for the station file with the first `from` in its text replaced by `to`.
  template <class... Parts>
  void rejects_change(const std::string& from, const std::string& to, const Parts&... parts) const {
    std::string text = Sections().text();
    const std::size_t at = text.find(from);
    ASSERT_NE(at, std::string::npos) << from;
    text.replace(at, from.size(), to);
    folder_.write("station.toml", text);
    expect_error(
        ErrorCode::input, [&] { read_station_file(folder_ / "station.toml"); }, "station.toml", parts...);
  }

  TemporaryFolder folder_;
};

TEST_F(StationFileTest, ReadsACompleteStation) {
  Sections sections;
  sections.station += "unit = \"m\"\n";
  sections.polarized +=
      "angle_direction = \"cw\"\nangle_zero_deg = -2.5\nresponse = \"gamma:2.2\"\nwhite_level = 16383\nblack_level = "
      "64\n"
      "frames_averaged = 16\nfull_well_e = 20000\nread_noise_e = 8.5\nmask = \"mask.png\"\nchannel = \"green\"\n";
  sections.rest =
      "[optics]\nrefractive_index = 1.45\nreflection = \"specular\"\n"
      "[[patch]]\nname = \"label\"\nbox = [1, 2, 11, 7]\n[[profile]]\nfrom = [0, 0]\nto = [11, 7.0]\n";
  const StationFile station = read(sections);
  EXPECT_EQ(station.name, "test");
  EXPECT_EQ(station.unit, "m");
  ASSERT_EQ(station.polarized.images.size(), 3u);
  EXPECT_EQ(station.polarized.images[1], folder_ / "pol/a_045.png");
  EXPECT_EQ(*station.polarized.angles_deg, (std::vector<double>{0, 45, 90}));
  EXPECT_EQ(station.polarized.angle_direction, AngleDirection::clockwise);
  EXPECT_EQ(station.polarized.angle_zero_deg, -2.5);
  EXPECT_EQ(station.polarized.response.text(), "gamma:2.2");
  EXPECT_EQ(station.polarized.response.exponent(), 2.2);
  EXPECT_EQ(*station.polarized.white_level, 16383);
  EXPECT_EQ(station.polarized.black_level, 64);
  EXPECT_EQ(station.polarized.frames_averaged, 16);
  EXPECT_EQ(*station.polarized.read_noise_e, 8.5);
  EXPECT_EQ(station.polarized.channel, ColorChannel::green);
  EXPECT_EQ(*station.polarized.mask, folder_ / "mask.png");
  EXPECT_EQ(*station.optics.refractive_index, 1.45);
  EXPECT_EQ(station.optics.reflection, ReflectionChoice::specular);
  EXPECT_EQ(std::get<CloudFile>(*station.prior).path, folder_ / "cloud.ply");
  ASSERT_TRUE(station.camera);
  EXPECT_EQ(station.camera->lens.params, (std::vector<double>{100, 101, 5.5, 4.0})) << "COLMAP's convention minus 0.5";
  EXPECT_EQ(station.camera->pose.translation, Eigen::Vector3d(0, 0, 50));
  ASSERT_EQ(station.patches.size(), 1u);
  EXPECT_EQ(station.patches[0].box, (std::array{1, 2, 11, 7}));
  ASSERT_EQ(station.profiles.size(), 1u);
  EXPECT_EQ(station.profiles[0].name, "1");
  EXPECT_EQ(station.profiles[0].to[1], 7);
}

TEST_F(StationFileTest, DefaultsAreThoseOfTheSpecs) {
  const StationFile station = read({});
  EXPECT_EQ(station.unit, "mm");
  EXPECT_EQ(station.polarized.response.text(), "linear");
  EXPECT_TRUE(station.polarized.response.is_identity());
  EXPECT_FALSE(station.polarized.white_level);
  EXPECT_EQ(station.optics.refractive_index, 1.5);
  EXPECT_EQ(station.optics.reflection, ReflectionChoice::automatic);
  Sections unnamed;
  unnamed.station.clear();
  EXPECT_EQ(read(unnamed).name, folder_.path().filename().string());
}

TEST_F(StationFileTest, UnknownKeysNameTheNearestKnownOne) {
  rejects_change("angles_deg", "angle_deg", "line 5", "[polarized].angle_deg", "\"angles_deg\"");
  rejects_change("[prior]", "[priors]", "priors", "\"prior\"");
  rejects_change("cloud =", "clould =", "[prior].clould", "\"cloud\"");
  rejects_change("qvec", "q_vec", "[camera].q_vec", "\"qvec\"");
  Sections sections;
  sections.rest = "[[patch]]\nname = \"a\"\nbox = [0, 0, 1, 1]\n[[patch]]\nboxes = [0, 0, 1, 1]\n";
  rejects(sections, "[[patch]] 2.boxes", "\"box\"");
}

TEST_F(StationFileTest, WrongTypesAndValuesNameFieldValueAndExpectation) {
  rejects_change("name = \"test\"", "name = 5", "line 2", "[station].name = 5", "text in quotes");
  rejects_change("name = \"test\"", "unit = \"furlong\"", "[station].unit", "furlong", "\"mm\"");
  rejects_change("angles_deg = [0, 45, 90]", "angles_deg = [0, 45, \"x\"]", "angles_deg", "list of numbers");
  rejects_change("angles_deg = [0, 45, 90]", "angles_deg = [0, 45, nan]", "angles_deg", "list of numbers");
  rejects_change("angles_deg = [0, 45, 90]", "angles_deg = 45", "angles_deg = 45", "\"auto\"");
  rejects_change("angles_deg = [0, 45, 90]", "angles_deg = [0, 45]", "2 angles for 3 images");
  rejects_change("angles_deg = [0, 45, 90]", "", "angles_deg", "is missing");
  rejects_change("width = 12", "width = 12.5", "[camera].width = 12.5", "whole number");
  rejects_change("width = 12", "width = 0", "[camera].width = 0", "from 1 to 65536");
  rejects_change("width = 12", "width = 13", "[camera]", "13 x 8", "12 x 8");
  rejects_change("params = [100, 101, 6.0, 4.5]", "params = [100, 101, 6.0]", "3 parameters", "expected 4");
  rejects_change("\"PINHOLE\"", "\"FISHEYE\"", "[camera].model", "FISHEYE", "FULL_OPENCV");
  rejects_change("qvec = [1, 0, 0, 0]", "qvec = [1, 0, 0]", "qvec", "list of 4 numbers");
  rejects_change("qvec = [1, 0, 0, 0]", "qvec = [0, 0, 0, 0]", "qvec", "no direction");
  rejects_change("tvec = [0, 0, 50]", "", "tvec", "is missing");
  rejects_change("[prior]", "[prior", "not TOML");
  rejects_change("\"cloud.ply\"", R"("C:\data\cloud.ply")", "not TOML", "folders are separated by /");
  rejects_change("\"cloud.ply\"", R"('data\cloud.ply')", "no such file", "folders are separated by /");
  rejects_change("\"test\"", "\"Th\xe9odore\"", "not TOML", "expected it saved as UTF-8");
  Sections scalar;
  scalar.prior.clear();
  scalar.station = "prior = 3\n[station]\n";
  rejects(scalar, "line 1", "prior = 3", "a table, [prior]");
  const auto polarized = [&](const std::string& line, const auto&... parts) {
    Sections sections;
    sections.polarized += line + "\n";
    rejects(sections, parts...);
  };
  polarized("angle_direction = \"clockwise\"", "clockwise", "\"ccw\", \"cw\"");
  polarized("response = \"gamma:x\"", "gamma:x", "from 0.1 to 10");
  polarized("response = \"rec709\"", "rec709", "lookup table");
  polarized("white_level = 0", "white_level = 0", "greater than 0");
  polarized("white_level = 100\nblack_level = 100", "black_level = 100", "less than the white level");
  polarized("frames_averaged = 0", "frames_averaged = 0", "from 1");
  polarized("channel = \"infrared\"", "infrared", "luminance");
  polarized("channel_weights = [0, 0, 0]", "channel_weights", "positive");
  polarized("channel_weights = [1, 0]", "channel_weights", "3 numbers");
  polarized("channel = \"red\"\nchannel_weights = [1, 0, 0]", "channel", "together");
  polarized("mask = \"none.png\"", "[polarized].mask", "none.png", "no such file");
  polarized("mosaic = [[90, 45], [135, 0]]", "images", "expected one");
  polarized("angle_pattern = \"(x)\"", "angle_pattern", "one of the two");
  const auto optics = [&](const std::string& line, const auto&... parts) {
    Sections sections;
    sections.rest = "[optics]\n" + line + "\n";
    rejects(sections, parts...);
  };
  optics("refractive_index = 0.5", "refractive_index = 0.5", "from 1.05 to 3");
  optics("refractive_index = 0.9", "refractive_index = 0.9,", "from 1.05 to 3");
  optics("refractive_index = \"glass\"", "refractive_index", "a number");
  optics("reflection = \"shiny\"", "shiny", "\"diffuse\"");
}

TEST_F(StationFileTest, ReadsTheMetal) {
  const auto metal = [&](const std::string& lines) {
    Sections sections;
    sections.rest = "[optics]\n" + lines + "\n";
    return read(sections).optics.metal;
  };
  EXPECT_EQ(read({}).optics.metal, "auto");
  EXPECT_EQ(metal("metal = \"none\"\nreflection = \"diffuse\""), "none");
  EXPECT_EQ(metal("metal = \"bronze\"\nreflection = \"specular\""), "bronze");
  EXPECT_EQ(metal("metal = \"0.7 + 2.6i\""), "0.7 + 2.6i");
  EXPECT_EQ(metal("metal = [0.7, 2.6]"), "0.7+2.6i");
  EXPECT_EQ(metal("metal = [1, 3]"), "1+3i");
}

TEST_F(StationFileTest, MetalsThatAreUnknownOrContradictTheReflectionAreRefused) {
  const auto refused = [&](const std::string& lines, const auto&... parts) {
    Sections sections;
    sections.rest = "[optics]\n" + lines + "\n";
    rejects(sections, "[optics].metal", parts...);
  };
  refused("metal = \"bronz\"", "bronz", "\"silver\"", "\"bronze\"", "[0.7, 2.6]");
  refused("metal = [0.7, 0]", "k from 0.5 to 20");
  refused("metal = [0.7, nan]", "numbers");
  refused("metal = [0.7]", "list of 2 numbers");
  refused("metal = 0.7", "0.7", "\"silver\"");
  refused("metal = \"bronze\"\nreflection = \"diffuse\"", "bronze", "reflection = \"diffuse\"", "\"none\"");
  refused("metal = \"bronze\"\nreflection = \"label.png\"", "labels", "whole object");
}

TEST_F(StationFileTest, KeysOfManyPartsAreRefusedWhereverTheyStand) {
  const auto key = [](const std::string& part, int parts) {
    std::string text = part;
    for (int more = 1; more < parts; ++more) text += "." + part;
    return text;
  };
  std::string nested = "x = ";
  for (int table = 0; table < 200; ++table) nested += "{" + key("a", 99) + " = ";
  std::vector<std::string> lines{nested};
  // In quotes a part may hold any character.
  for (const char* part : {"a", R"("#")", R"("=")", R"("\"")", R"("\\")", R"("'")", R"('"')", "'#'", "'{'", R"('\')"}) {
    const std::string many = key(part, 10'000);
    for (const char* before : {"", "x = {", "x = [1.5, {y = 1, ", "x = [\n# '\n{", "x = \"\"\"\\\"\n\"\"\"\"\"\n",
                               "x = '''\\\n'''''\n", "x = ''\n"}) {
      lines.push_back(before + many + " = 1");
    }
    lines.push_back("[" + many + "]");
    lines.push_back("[[" + many + "]]");
  }
  for (const std::string& line : lines) {
    Sections sections;
    sections.rest = line + "\n";
    rejects(sections, "a key of more than 100 parts");
  }
}

TEST_F(StationFileTest, DotsInATextOrListAreNoPartsOfAKey) {
  const std::string dots(120, '.');
  for (const std::string& text : {"\"\"\"\nContents " + dots + " 5\n\"\"\"", "'" + dots + "'",
                                  "\"\\\"" + dots + "\" # " + dots, "'''" + dots + "''" + dots + "'''''"}) {
    Sections sections;
    sections.rest = "[object]\ndescription = " + text + "\n";
    EXPECT_NO_THROW(read(sections)) << text;
  }
  std::string numbers = "0.5";
  for (int more = 0; more < 120; ++more) numbers += ", 0.5";
  Sections sections;
  sections.rest = "[object]\nx = [" + numbers + ", {y = [" + numbers + "]}]\n";
  rejects(sections, "x: unknown key");
}

TEST_F(StationFileTest, MissingFilesAreNamed) {
  rejects_change("pol/a_045.png", "pol/a_046.png", "[polarized].images", "a_046.png", "no such file");
  rejects_change("pol/a_045.png", "pol/a_000.png", "a_000.png", "listed twice");
  rejects_change("cloud.ply", "absent.ply", "[prior].cloud", "absent.ply", "no such file");
  rejects_change("cloud.ply", "views", "[prior].cloud", "is a folder");
  folder_.write("pol/a_000.png", "none of the images that can be read");
  rejects({}, "a_000.png", "none of the images that can be read");
  expect_error(
      ErrorCode::input, [&] { read_station_file(folder_ / "none.toml"); }, "none.toml", "no such file");
  expect_error(
      ErrorCode::input, [&] { read_station_file(folder_.write("empty.toml", "")); }, "is empty");
}

TEST_F(StationFileTest, FewerThanThreeAnglesIsADataError) {
  const auto data_error_for = [&](const std::string& angles) {
    Sections sections;
    sections.polarized.replace(sections.polarized.find("[0, 45, 90]"), 11, angles);
    expect_error(
        ErrorCode::data, [&] { read(sections); }, "[polarized].angles_deg", "2 distinct", "modulo 180");
  };
  data_error_for("[0, 45, 180]");
  data_error_for("[0, 90, 90]");
  data_error_for("[-90, 0, 270]");
  data_error_for("[179.9999, 0, 45]");
  Sections two;
  two.polarized = "[polarized]\nimages = [\"pol/a_000.png\", \"pol/a_045.png\"]\nangles_deg = \"auto\"\n";
  expect_error(
      ErrorCode::data, [&] { read(two); }, "2 images", "at least 5");
  Sections repeated;
  write_png(folder_ / "pol/b_000.png", Image<std::uint8_t>({12, 8}));
  repeated.polarized =
      "[polarized]\nimages = [\"pol/a_000.png\", \"pol/b_000.png\", \"pol/a_045.png\", \"pol/a_090.png\"]\n"
      "angles_deg = [0, 0, 45, 90]\n";
  EXPECT_EQ(read(repeated).polarized.angles_deg->size(), 4u) << "two images at the same angle are two exposures";
}

TEST_F(StationFileTest, AnglesInRadiansAreRefused) {
  for (const char* angles : {"[0, 0.785, 1.571]", "[-1.571, 0, 1.571]", "[0, 3.14159, 6.28]"})
    rejects_change("[0, 45, 90]", angles, "[polarized].angles_deg", "all angles lie within 6.3°", "radians?");
  Sections narrow;
  narrow.polarized.replace(narrow.polarized.find("[0, 45, 90]"), 11, "[0, 4, 7]");
  EXPECT_EQ(read(narrow).polarized.angles_deg->size(), 3u);
}

TEST_F(StationFileTest, ReadsFoldersGlobsAndAnglePatterns) {
  const auto angles = [&](const std::string& lines) {
    Sections sections;
    sections.polarized = "[polarized]\n" + lines + "\n";
    return read(sections).polarized.angles_deg;
  };
  const std::vector<double> expected{0, 45, 90};
  folder_.write("pol/notes.txt", "x");
  EXPECT_EQ(angles("images = \"pol\""), expected);
  EXPECT_EQ(angles("images = \"pol/*.png\""), expected);
  EXPECT_EQ(angles("images = \"pol\"\nangle_pattern = 'a_(\\d+)\\.png'"), expected);
  EXPECT_EQ(angles("images = \"pol\"\nangles_deg = [1, 61, 121]"), (std::vector<double>{1, 61, 121}));
  for (const std::string name : {"b_1", "b_2"})
    write_png(folder_ / ("pol/" + name + ".png"), Image<std::uint8_t>({12, 8}));
  EXPECT_FALSE(angles("images = \"pol\"\nangles_deg = \"auto\""));
  for (const std::string name : {"b_1", "b_2"}) std::filesystem::remove(folder_ / ("pol/" + name + ".png"));
  const auto rejects_lines = [&](const std::string& lines, const auto&... parts) {
    Sections sections;
    sections.polarized = "[polarized]\n" + lines + "\n";
    rejects(sections, parts...);
  };
  rejects_lines("images = \"pol/*.tif\"", "pol/*.tif", "pattern that matches files");
  rejects_lines("images = \"pol\"\nangle_pattern = 'a_\\d+'", "angle_pattern", "one group");
  rejects_lines("images = \"pol\"\nangle_pattern = 'a_(\\d+'", "angle_pattern", "not a regular expression");
  rejects_lines("images = \"pol\"\nangle_pattern = 'b_(\\d+)'", "angle_pattern", "no angle in the name");
  folder_.write("pol/a_045.jpg", "x");
  rejects_lines("images = \"pol\"", "images", "a_045.jpg and a_045.png have the same name", "one file of each image");
  EXPECT_EQ(angles("images = \"pol/*.png\""), expected);
}

TEST(PolarizedFiles, NaturalOrderAndAngleByPattern) {
  EXPECT_TRUE(natural_less("pol_9.png", "pol_10.png"));
  EXPECT_FALSE(natural_less("pol_10.png", "pol_9.png"));
  EXPECT_TRUE(natural_less("a2b10", "a02b11"));
  EXPECT_FALSE(natural_less("a", "a"));
  EXPECT_TRUE(natural_less("a", "ab"));
  EXPECT_EQ(angle_of_name("/x/p060_e3.png", "p(\\d+)_", "test"), 60);
  expect_error(
      ErrorCode::input, [] { angle_of_name("/x/none.png", "(\\d+)", "images"); }, "images", "none.png");
}

TEST(AnglesOfNames, AreReadOnlyFromUnambiguousNames) {
  using Names = std::vector<std::filesystem::path>;
  const auto angles = [](const Names& names) { return angles_of_names(names, "images", "expected angles_deg"); };
  const std::vector<double> expected{0, 45, 90};
  for (const Names& names :
       {Names{"/x/IMG_1234_pol_0.tif", "/x/IMG_1235_pol_45.tif", "/x/IMG_1236_pol_90.tif"},
        Names{"/x/IMG_7_deg0.tif", "/x/IMG_8_deg45.tif", "/x/IMG_9_deg90.tif"},
        Names{"/x/000deg.png", "/x/045deg.png", "/x/090deg.png"}, Names{"/x/a 0°.png", "/x/a 45°.png", "/x/a 90°.png"},
        Names{"/x/pol/000.png", "/x/pol/045.png", "/x/pol/090.png"},
        Names{"/x/Polarized/a_0.png", "/x/Polarized/a_45.png", "/x/Polarized/a_90.png"}}) {
    EXPECT_EQ(angles(names), expected) << names[0];
  }
  EXPECT_EQ(angles({"/x/angle22.5.png", "/x/angle0.png", "/x/angle67.5.png"}), (std::vector<double>{22.5, 0, 67.5}));
  EXPECT_EQ(angles({"/x/rot-0.png", "/x/rot-120.png", "/x/rot-240.png"}), (std::vector<double>{0, 120, 240}));
  // A dash is a separator if all names have it, else a sign.
  for (const Names& names : {Names{"/x/pol_-45.png", "/x/pol_0.png", "/x/pol_45.png", "/x/pol_90.png"},
                             Names{"/x/pol--45.png", "/x/pol-0.png", "/x/pol-45.png", "/x/pol-90.png"},
                             Names{"/x/-45°.png", "/x/0°.png", "/x/45°.png", "/x/90°.png"},
                             Names{"/x/pol/-45.png", "/x/pol/0.png", "/x/pol/45.png", "/x/pol/90.png"}}) {
    EXPECT_EQ(angles(names), (std::vector<double>{-45, 0, 45, 90})) << names[0];
  }
  for (const Names& names :
       {Names{"/x/IMG_0123.JPG", "/x/IMG_0124.JPG", "/x/IMG_0125.JPG"},
        Names{"/x/pol/IMG_0120.JPG", "/x/pol/IMG_0125.JPG", "/x/pol/IMG_0130.JPG"},
        Names{"/x/pol_1.png", "/x/pol_2.png", "/x/pol_3.png"},        // counts, not angles
        Names{"/x/pol_0.png", "/x/pol_5.png", "/x/pol_10.png"},       // counts in steps of five
        Names{"/x/a_000.png", "/x/a_045.png", "/x/a_090.png"},        // no word for an angle
        Names{"/x/pol_000.png", "/x/pol_045.png", "/x/pol_180.png"},  // only two different angles modulo 180
        Names{"/x/pol_000.png", "/x/pol_045.png", "/x/other.png"}}) {
    expect_error(
        ErrorCode::input, [&] { angles(names); }, "images", names[0].filename().string(), "expected angles_deg");
  }
}

TEST_F(StationFileTest, ReadsExposures) {
  for (const std::string name : {"b_000", "b_045", "b_090"})
    write_png(folder_ / ("pol/" + name + ".png"), Image<std::uint8_t>({12, 8}));
  const auto with = [&](const std::string& lines) {
    Sections sections;
    sections.polarized = "[polarized]\nimages = \"pol\"\n" + lines + "\n";
    return sections;
  };
  const StationFile station = read(with("exposure_s = [0.01, 0.01, 0.01, 0.04, 0.04, 0.04]"));
  EXPECT_EQ(station.polarized.exposure_s->size(), 6u);
  rejects(with("exposure_s = [0.01, 0.04]"), "exposure_s", "2 times for 6 images");
  rejects(with("exposure_s = [0.01, 0.01, 0.01, 0.04, 0.04, 0.08]"), "exposure_s", "same exposures at every angle");
  rejects(with("exposure_s = [0.01, 0.01, 0.01, 0.04, 0.04, 0]"), "exposure_s");
  rejects(with("angles_deg = \"auto\"\nexposure_s = [1, 1, 1, 1, 1, 1]"), "exposure_s", "needs known angles");
}

TEST_F(StationFileTest, RawFilesTakePrecedenceAndBringTheirLevels) {
  for (const std::string name : {"a_000.NEF", "a_045.NEF", "a_090.NEF"}) folder_.write("pol/" + name, "x");
  Sections sections;
  sections.polarized = "[polarized]\nimages = \"pol\"\n";
  const StationFile station = read(sections);
  ASSERT_EQ(station.polarized.images.size(), 3u);
  EXPECT_TRUE(is_raw_name(station.polarized.images[0]));
  expect_error(
      ErrorCode::input, [&] { read_image(station.polarized.images[0]); }, "a_000.NEF", "RAW file", "malus[raw]");
  for (const std::string key : {"response = \"srgb\"", "white_level = 4095", "black_level = 1"}) {
    sections.polarized = "[polarized]\nimages = \"pol\"\n" + key + "\n";
    rejects(sections, "is not for RAW files");
  }
  sections.polarized =
      "[polarized]\nimages = [\"pol/a_000.NEF\", \"pol/a_045.png\", \"pol/a_090.png\"]\nangles_deg = [0, 45, 90]\n";
  rejects(sections, "expected one kind");
}

TEST_F(StationFileTest, AFileCalledAsAResponseIsATableOnlyByItsPath) {
  folder_.write("linear", "0 0\n1 1\n");
  folder_.write("gamma:2.2", "0 0\n1 1\n");
  const auto response_in = [&](const std::string& text) {
    Sections sections;
    sections.polarized += "response = \"" + text + "\"\n";
    return read(sections).polarized.response;
  };
  EXPECT_FALSE(response_in("linear").table());
  EXPECT_FALSE(response_in("gamma:2.2").table());
  EXPECT_EQ(response_in("./linear").table(), folder_ / "linear");
  EXPECT_EQ(response_in("./linear").text(), (folder_ / "linear").string());
}

TEST_F(StationFileTest, ReadsAMosaic) {
  Sections sections;
  sections.polarized = "[polarized]\nimages = [\"pol/a_000.png\"]\nmosaic = [[90, 45], [135, 0]]\n";
  const StationFile station = read(sections);
  EXPECT_EQ(*station.polarized.mosaic, (std::array<double, 4>{90, 45, 135, 0}));
  const std::string mosaic = sections.polarized;
  sections.polarized = mosaic + "mosaic_colors = \"RGGB\"\n";
  EXPECT_EQ(read(sections).polarized.mosaic_colors, BayerPattern::rggb);
  sections.polarized = mosaic + "mosaic_colors = \"RGBG\"\n";
  rejects(sections, "mosaic_colors", "\"GBRG\"");
  sections.polarized = "[polarized]\nimages = [\"pol/a_000.png\"]\nmosaic = [[90, 45], [135]]\n";
  rejects(sections, "mosaic", "two rows of two angles");
  sections.polarized = "[polarized]\nimages = [\"pol/a_000.png\"]\nmosaic = [[90, 0], [90, 0]]\n";
  expect_error(
      ErrorCode::data, [&] { read(sections); }, "2 distinct");
}

TEST_F(StationFileTest, ReadsACameraFromAColmapModel) {
  ColmapModel model;
  model.cameras[2] = {LensModel::opencv, {12, 8}, {100, 101, 5, 4, 0.1, 0, 0, 0}};
  model.images[1].name = "station.jpg";
  model.images[1].camera_id = 2;
  model.images[1].pose.translation = {1, 2, 3};
  std::filesystem::create_directories(folder_ / "sparse");
  write_colmap_model(folder_ / "sparse", model);
  Sections sections;
  sections.camera = "[camera]\ncolmap_model = \"sparse\"\nimage = \"station.jpg\"\n";
  const StationFile station = read(sections);
  EXPECT_EQ(station.camera->lens.params, model.cameras[2].params);
  EXPECT_EQ(station.camera->pose.translation, Eigen::Vector3d(1, 2, 3));
  sections.camera = "[camera]\ncolmap_model = \"sparse\"\nimage = \"other.jpg\"\n";
  rejects(sections, "[camera].image", "other.jpg", "station.jpg");
  sections.camera = "[camera]\ncolmap_model = \"views\"\nimage = \"station.jpg\"\n";
  expect_error(
      ErrorCode::input, [&] { read(sections); }, "views", "no cameras and images files");
  sections.camera = "[camera]\ncolmap_model = \"sparse\"\n";
  rejects(sections, "[camera].image", "is missing");
  sections.camera = "[camera]\ncolmap_model = \"sparse\"\nimage = \"station.jpg\"\nwidth = 12\n";
  rejects(sections, "[camera].width", "together with colmap_model");
  sections.camera = "[camera]\ncolmap_model = \"sparse\"\nimage = \"station.jpg\"\nk1 = -0.1\n";
  rejects(sections, "[camera].k1", "together with colmap_model");
}

TEST_F(StationFileTest, ReadsAPhotogrammetricCamera) {
  // A camera 100 mm above the XY plane looking straight down, upper image edge towards +Y: ω = φ = κ = 0.
  const std::string lens =
      "[camera]\nmodel = \"BROWN\"\nwidth = 12\nheight = 8\nfocal_mm = 20\npixel_mm = 0.01\nx0_mm = 0.01\nk1 = 1e-5\n";
  Sections sections;
  sections.camera = lens + "omega_phi_kappa_deg = [0, 0, 0]\ncenter = [1, 2, 100]\n";
  const StationFile station = read(sections);
  EXPECT_EQ(station.camera->lens.params, (std::vector<double>{20, 0.01, 0.01, 0, 1e-5, 0, 0, 0, 0, 0}));
  Sections decentered;
  decentered.camera = lens + "p1 = 1e-6\np2 = 2e-6\np3 = 3e-6\nomega_phi_kappa_deg = [0, 0, 0]\ncenter = [1, 2, 100]\n";
  EXPECT_EQ(read(decentered).camera->lens.params,
            (std::vector<double>{20, 0.01, 0.01, 0, 1e-5, 0, 0, 1e-6, 2e-6, 3e-6}));
  const Pose pose = station.camera->pose;
  EXPECT_LT((pose.center() - Eigen::Vector3d(1, 2, 100)).norm(), 1e-12);
  const Eigen::Vector3d below = pose.cam_from_world({1, 2, 0}), right = pose.cam_from_world({3, 2, 0}),
                        up = pose.cam_from_world({1, 5, 0});
  EXPECT_LT((below - Eigen::Vector3d(0, 0, 100)).norm(), 1e-12);
  EXPECT_LT((right - Eigen::Vector3d(2, 0, 100)).norm(), 1e-12);
  EXPECT_LT((up - Eigen::Vector3d(0, -3, 100)).norm(), 1e-12);

  // General angles against the printed elements of M (Wolf and Dewitt, world → image, x = −f M₁·ΔX / M₃·ΔX).
  sections.camera = lens + "omega_phi_kappa_deg = [10, -20, 130]\ncenter = [0, 0, 0]\n";
  const Eigen::Matrix3d m = Eigen::Vector3d(1, -1, -1).asDiagonal() * read(sections).camera->pose.rotation;
  const double degree = std::numbers::pi / 180, w = 10 * degree, p = -20 * degree, k = 130 * degree;
  EXPECT_NEAR(m(0, 0), std::cos(p) * std::cos(k), 1e-12);
  EXPECT_NEAR(m(0, 1), std::sin(w) * std::sin(p) * std::cos(k) + std::cos(w) * std::sin(k), 1e-12);
  EXPECT_NEAR(m(0, 2), -std::cos(w) * std::sin(p) * std::cos(k) + std::sin(w) * std::sin(k), 1e-12);
  EXPECT_NEAR(m(1, 0), -std::cos(p) * std::sin(k), 1e-12);
  EXPECT_NEAR(m(2, 0), std::sin(p), 1e-12);
  EXPECT_NEAR(m(2, 1), -std::sin(w) * std::cos(p), 1e-12);
  EXPECT_NEAR(m(2, 2), std::cos(w) * std::cos(p), 1e-12);

  sections.camera = lens;
  rejects(sections, "[camera].qvec", "is missing", "depth-map prior");
  sections.camera = lens + "params = [1]\n";
  rejects(sections, "[camera].params", "not used by model BROWN");
  rejects_change("width = 12", "width = 12\nk1 = 0.1", "[camera].k1", "BROWN");
}

TEST_F(StationFileTest, CameraWithoutPose) {
  Sections sections;
  const std::string lens = "[camera]\nmodel = \"PINHOLE\"\nwidth = 12\nheight = 8\nparams = [100, 101, 6.0, 4.5]\n";
  sections.camera = lens;
  rejects(sections, "[camera].qvec", "is missing");
  sections.prior = "[prior]\ndepth = \"depth.tif\"\n";
  EXPECT_EQ(read(sections).camera->pose.rotation, Eigen::Matrix3d::Identity()) << "the world is the station camera";
  sections.prior.clear();
  sections.rest = "[photos]\nfolder = \"views\"\n";
  const StationFile station = read(sections);
  EXPECT_FALSE(station.camera);
  ASSERT_TRUE(station.lens);
  EXPECT_EQ(station.lens->params[2], 5.5);
  EXPECT_FALSE(station.has_unused_pose);
  sections.camera += "qvec = [1, 0, 0, 0]\ntvec = [0, 0, 0]\n";
  EXPECT_TRUE(read(sections).has_unused_pose);
  sections.prior = "[prior]\ncloud = \"cloud.ply\"\n";
  EXPECT_FALSE(read(sections).has_unused_pose);
  sections.prior.clear();
  sections.camera.clear();
  EXPECT_FALSE(read(sections).lens);
  sections.rest.clear();
  sections.prior = "[prior]\ncloud = \"cloud.ply\"\n";
  rejects(sections, "camera", "is missing");
  // With a surface of [prior] the photos do not give the pose.
  sections.rest = "[photos]\nfolder = \"views\"\n";
  rejects(sections, "camera", "is missing", "with [prior]");
  sections.camera = "[camera]\nimage = \"1.jpg\"\n";
  rejects(sections, "[camera].model", "is missing");
  sections.camera = lens;
  rejects(sections, "[camera].qvec", "is missing", "[photos] and no [prior]");
  sections.prior = "[prior]\ndepth = \"depth.tif\"\n";
  EXPECT_EQ(read(sections).camera->pose.rotation, Eigen::Matrix3d::Identity());
  sections.camera.clear();
  sections.rest.clear();
  sections.prior.clear();
  EXPECT_FALSE(read(sections).camera) << "no camera is needed for the polarization maps";
}

TEST_F(StationFileTest, ReadsSigmaAndShapesOfPriors) {
  Sections sections;
  EXPECT_FALSE(read(sections).prior_sigma);
  sections.prior += "sigma = 0.25\n";
  EXPECT_EQ(read(sections).prior_sigma, 0.25);
  const auto shape = [&](const std::string& text) {
    sections.prior = "[prior]\nsigma = 2\n" + text + "\n";
    return std::get<Shape>(*read(sections).prior);
  };
  const auto plane = std::get<PlaneShape>(shape("plane = { point = [1, 2, 3], normal = [0, 0, -2] }"));
  EXPECT_EQ(plane.point, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(plane.normal, Eigen::Vector3d(0, 0, -2));
  const auto sphere = std::get<SphereShape>(shape("sphere = { center = [1, 2, 3], radius = 4 }"));
  EXPECT_EQ(sphere.center, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(sphere.radius, 4);
  const auto cylinder =
      std::get<CylinderShape>(shape("cylinder = { point = [1, 2, 3], axis = [0, 1, 0], radius = 5 }"));
  EXPECT_EQ(cylinder.axis, Eigen::Vector3d(0, 1, 0));
  EXPECT_EQ(cylinder.radius, 5);
  sections.camera = "[camera]\nmodel = \"PINHOLE\"\nwidth = 12\nheight = 8\nparams = [100, 101, 6.0, 4.5]\n";
  EXPECT_EQ(read(sections).camera->pose.translation, Eigen::Vector3d::Zero()) << "the world is the station camera";
}

TEST_F(StationFileTest, RejectsUnusableSigmasAndShapes) {
  const auto rejects_prior = [&](const std::string& text, const auto&... parts) {
    Sections sections;
    sections.prior = "[prior]\n" + text + "\n";
    rejects(sections, parts...);
  };
  rejects_prior("cloud = \"cloud.ply\"\nsigma = 0", "[prior].sigma = 0", "expected");
  rejects_prior("sigma = 1", "0 surfaces", "exactly one of cloud, mesh, depth, plane, sphere and cylinder");
  rejects_prior("cloud = \"cloud.ply\"\nsphere = { center = [0, 0, 9], radius = 1 }", "2 surfaces");
  rejects_prior("sphere = { center = [0, 0, 9], radius = 1 }", "[prior].sigma", "is missing", "from the sphere");
  rejects_prior("sigma = 1\nsphere = 3", "[prior].sphere = 3", "a table");
  rejects_prior("sigma = 1\nsphere = { center = [0, 0, 9] }", "[prior].sphere.radius", "is missing");
  rejects_prior("sigma = 1\nsphere = { center = [0, 0, 9], radius = -1 }", "[prior].sphere.radius = -1");
  rejects_prior("sigma = 1\nsphere = { centre = [0, 0, 9], radius = 1 }", "[prior].sphere.centre", "\"center\"");
  rejects_prior("sigma = 1\nplane = { point = [0, 9], normal = [0, 0, 1] }", "[prior].plane.point", "3 numbers");
  rejects_prior("sigma = 1\nplane = { point = [0, 0, 9], normal = [0, 0, 0] }", "[prior].plane.normal", "not all zero");
  rejects_prior("sigma = 1\ncylinder = { axis = [0, 1, 0], radius = 1 }", "[prior].cylinder.point", "is missing");
}

TEST_F(StationFileTest, ReadsPhotosAndScale) {
  Sections sections;
  sections.camera.clear();
  sections.prior.clear();
  const std::string photos =
      "[photos]\nfolder = \"views\"\nexclude = [\"x.jpg\"]\n"
      "camera = { model = \"PINHOLE\", width = 90, height = 60, params = [100, 100, 45, 30] }\n";
  const std::string a = "a = [{ image = \"1.jpg\", x = 1, y = 2 }, { image = \"2.jpg\", x = 3.5, y = 4 }]\n";
  const std::string b = "b = [{ image = \"1.jpg\", x = 5, y = 6 }, { image = \"2.jpg\", x = 7, y = 8 }]\n";
  sections.rest = photos + "[[scale]]\ndistance = 31.5\ncheck = true\n" + a + b +
                  "[[scale]]\ndistance = 50\ntargets = [3, 7]\ntargets_dictionary = \"aruco_4x4_50\"\n";
  const StationFile station = read(sections);
  EXPECT_EQ(station.photos->folder, folder_ / "views");
  EXPECT_EQ(station.photos->camera->params[2], 44.5);
  ASSERT_EQ(station.scale_bars.size(), 2u);
  EXPECT_TRUE(station.scale_bars[0].check);
  EXPECT_EQ(station.scale_bars[0].a[1].x, 3.5) << "marks are in the memory convention: no half pixel";
  EXPECT_EQ(station.scale_bars[1].targets, (std::array<int, 2>{3, 7}));
  EXPECT_EQ(station.scale_bars[1].targets_dictionary, TargetDictionary::aruco_4x4_50);
  const auto rejects_scale = [&](const std::string& scale, const auto&... parts) {
    Sections changed = sections;
    changed.rest = photos + "[[scale]]\n" + scale;
    rejects(changed, parts...);
  };
  rejects_scale("distance = -1\n" + a + b, "[[scale]] 1.distance = -1", "greater than 0");
  rejects_scale(a + b, "distance", "is missing");
  rejects_scale("distance = 1\n" + a, "[[scale]] 1.b", "0 marks", "different photos");
  rejects_scale("distance = 1\n" + a + "b = [{ image = \"9.jpg\", x = 1, y = 2 }]\n", "9.jpg", "no such file");
  rejects_scale("distance = 1\n" + a + "b = [{ image = \"1.jpg\", x = 1, z = 2 }]\n", "unknown key", "\"x\"");
  rejects_scale(
      "distance = 1\n" + a + "b = [{ image = \"1.jpg\", x = 1, y = 2 }, { image = \"1.jpg\", x = 1, y = 2 }]\n",
      "1.jpg", "one mark a photo");
  rejects_scale("distance = 1\ntargets = [3, 3]\ntargets_dictionary = \"d\"\n", "targets", "different");
  rejects_scale("distance = 1\ntargets = [3, 4]\n", "targets_dictionary", "is missing");
  rejects_scale("distance = 1\ntargets = [3, 4]\ntargets_dictionary = \"aruco_4x4\"\n", "targets_dictionary",
                "\"aruco_4x4_50\"", "\"apriltag_36h11\"");
  Sections without = {};
  without.rest = "[[scale]]\ndistance = 1\n" + a + b;
  rejects(without, "scale", "marks need the cameras of their images");
  without.rest = "[[scale]]\ndistance = 1\n";
  rejects(without, "[[scale]] 1.a", "0 marks", "a_xyz");
}

/// Control points as marked by the camera of `Sections`, 50 in front of the plane z = 0.
std::string control_text(const std::string& pixel_of_last) {
  return "[[control]]\nname = \"P1\"\nxyz = [-2, -1, 0]\npixel = [1.5, 1.98]\n"
         "[[control]]\nname = \"P2\"\nxyz = [2, -1, 0]\npixel = [9.5, 1.98]\n"
         "[[control]]\nname = \"P3\"\nxyz = [2, 1, 10]\npixel = [8.83333333, 5.68333333]\n"
         "[[control]]\nname = \"P4\"\nxyz = [-2, 1, -10]\npixel = [0.5, 6.525]\n"
         "[[control]]\nname = \"P5\"\nxyz = [0, 0, 20]\npixel = " +
         pixel_of_last + "\n";
}

TEST_F(StationFileTest, ReadsCurvePixels) {
  Sections sections;
  sections.polarized += "curve_pixels = [[0, 7], [11, 0]]\n";
  EXPECT_EQ(read(sections).polarized.curve_pixels, (std::vector<std::array<double, 2>>{{0, 7}, {11, 0}}));
  for (const std::string wrong : {"[3, 4]", "[[1.5, 2]]", "[[1, 2, 3]]", "7"}) {
    sections.polarized = Sections().polarized + "curve_pixels = " + wrong + "\n";
    rejects(sections, "curve_pixels", "a list of at most 8 pixels");
  }
  sections.polarized = Sections().polarized + "curve_pixels = [[12, 0]]\n";
  rejects(sections, "curve_pixels [12, 0]", "12 x 8");
}

TEST_F(StationFileTest, ControlPointsGiveThePose) {
  Sections sections;
  sections.camera = "[camera]\nmodel = \"PINHOLE\"\nwidth = 12\nheight = 8\nparams = [100, 101, 6.0, 4.5]\n";
  sections.rest = control_text("[5.5, 4.0]");
  const StationFile station = read(sections);
  ASSERT_TRUE(station.resection);
  EXPECT_LT((station.camera->pose.center() - Eigen::Vector3d(0, 0, -50)).norm(), 1e-3);
  EXPECT_EQ(station.control.size(), 5U);
  EXPECT_EQ(station.control[4].name, "P5");

  sections.camera = Sections().camera;  // with a given pose, the points only check it
  EXPECT_FALSE(read(sections).resection);

  // A lens for another image size must be reported before wrong points.
  sections.camera = "[camera]\nmodel = \"PINHOLE\"\nwidth = 6\nheight = 4\nparams = [50, 50.5, 3.0, 2.25]\n";
  sections.rest = control_text("[5.5, 4.0]");
  rejects(sections, "[camera]", "is for 6 x 4 pixels", "has 12 x 8");
  // Same for images taken in portrait orientation, which the files state in EXIF.
  sections.camera = "[camera]\nmodel = \"PINHOLE\"\nwidth = 8\nheight = 12\nparams = [50, 50.5, 3.0, 2.25]\n";
  rejects(sections, "[camera]", "is for 8 x 12 pixels", "EXIF orientation is ignored");
  sections.camera = Sections().camera;

  sections.rest = control_text("[12.0, 4.0]");
  rejects(sections, "control", "point P5 has pixel = [12, 4]", "12 x 8");
  sections.rest = control_text("[5.5, 4.0]\n[[scale]]\ndistance = 3\na_xyz = [0, 0, 0]\nb_xyz = [1, 0, 0]");
  rejects(sections, "scale", "together with [[control]]");
  sections.rest = "[[control]]\nxyz = [0, 0, 20]\n";
  rejects(sections, "[[control]] 1", "pixel", "is missing");
  sections.rest = "[[control]]\npixel = [1, 2]\n";
  rejects(sections, "[[control]] 1", "xyz", "is missing");
  sections.camera.clear();
  sections.prior.clear();
  sections.rest = control_text("[5.5, 4.0]");
  rejects(sections, "control", "needs [camera] with the lens");
}

TEST_F(StationFileTest, MayLeaveOutThePhotosThatAnotherFileNames) {
  Sections sections;
  sections.camera = "[camera]\nmodel = \"PINHOLE\"\nwidth = 12\nheight = 8\nparams = [100, 101, 6.0, 4.5]\n";
  sections.prior = "";
  rejects(sections, "qvec");
  std::filesystem::create_directories(folder_ / "other");
  const std::filesystem::path other = folder_.write(
      "other/object.toml", "[object]\nname = \"x\"\n[photos]\nfolder = \"../views\"\nexclude = [\"2.jpg\"]\n");
  const StationFile station = read_station_file(folder_ / "station.toml", other);
  EXPECT_TRUE(station.frame_is_of_photos() && station.lens && !station.camera);
  EXPECT_EQ(station.photos->folder, folder_ / "views");
  EXPECT_EQ(station.photos->exclude, std::vector<std::string>{"2.jpg"});
  const auto rejects_photos = [&](const std::string& photos, const auto&... parts) {
    folder_.write("other/object.toml", photos);
    expect_error(
        ErrorCode::input, [&] { read_station_file(folder_ / "station.toml", other); }, "other/object.toml, line",
        parts...);
  };
  rejects_photos("\n[photos]\nfolder = \"none\"\n", "line 3", "[photos].folder", "an existing folder");
  rejects_photos("[photos]\nfolder = \"../views\"\nexcludes = []\n", "line 3", "[photos].excludes", "unknown key");
  const StationFile with_prior = read_station_file(folder_.write("station.toml", Sections().text()), other);
  EXPECT_FALSE(with_prior.photos.has_value());
}

TEST_F(StationFileTest, ControlPointsMarkedInPhotos) {
  Sections sections;
  sections.prior = "[photos]\nfolder = \"views\"\n";
  sections.camera = "[camera]\nmodel = \"PINHOLE\"\nwidth = 12\nheight = 8\nparams = [100, 101, 6.0, 4.5]\n";
  sections.rest =
      "[[control]]\nxyz = [1, 2, 3]\nmarks = [{ image = \"1.jpg\", x = 1.0, y = 2.0 }, { image = \"2.jpg\", x = 3.0, y "
      "= 4.0 }]\ncheck = true\n";
  const StationFile station = read(sections);
  EXPECT_FALSE(station.camera);
  EXPECT_TRUE(station.frame_is_of_photos());
  ASSERT_EQ(station.control.size(), 1U);
  EXPECT_EQ(station.control[0].name, "1");
  EXPECT_TRUE(station.control[0].check);
  ASSERT_EQ(station.control[0].marks.size(), 2U);
  EXPECT_EQ(station.control[0].marks[1].image, "2.jpg");
  sections.rest = "[[control]]\nxyz = [1, 2, 3]\n";
  rejects(sections, "[[control]] 1", "marks", "is missing");
  sections.rest = "[[control]]\nxyz = [1, 2, 3]\nmarks = [{ image = \"9.jpg\", x = 1.0, y = 2.0 }]\n";
  rejects(sections, "[[control]] 1", "9.jpg");
}

TEST_F(StationFileTest, PatchesAndProfilesMustLieInTheImage) {
  const auto rejects_rest = [&](const std::string& rest, const auto&... parts) {
    Sections sections;
    sections.rest = rest;
    rejects(sections, parts...);
  };
  rejects_rest("[[patch]]\nbox = [0, 0, 12, 7]\n", "[[patch]] 1.box", "12 x 8 pixels");
  rejects_rest("[[patch]]\nbox = [-1, 0, 5, 7]\n", "box", "within");
  rejects_rest("[[patch]]\nbox = [5, 0, 4, 7]\n", "box", "x0");
  rejects_rest("[[patch]]\nbox = [0.5, 0, 4, 7]\n", "box", "whole numbers");
  rejects_rest("[[patch]]\nname = \"a\"\nbox = [0, 0, 1, 1]\n[[patch]]\nname = \"a\"\nbox = [0, 0, 1, 1]\n",
               "[[patch]] 2", "twice");
  rejects_rest("[[profile]]\nfrom = [0, 0]\nto = [12, 0]\n", "[[profile]] 1.to", "within");
  rejects_rest("[[profile]]\nfrom = [1, 1]\nto = [1, 1]\n", "to", "another pixel");
  rejects_rest("[patch]\nbox = [0, 0, 1, 1]\n", "patch", "[[patch]]");
}

TEST(StationFile, EveryRenderedStationLoads) {
  const std::filesystem::path data = shared_data() / "rendered";
  if (!std::filesystem::exists(data)) GTEST_SKIP() << data << " is absent";
  int count = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(data)) {
    const std::string name = entry.path().filename().string();
    if (!name.starts_with("station") || entry.path().extension() != ".toml") continue;
    SCOPED_TRACE(entry.path());
    const StationFile station = read_station_file(entry.path());
    EXPECT_EQ(station.polarized.images.size(), 6u);
    EXPECT_EQ(station.polarized.angles_deg->at(5), 150);
    if (name == "station_photos.toml") {
      EXPECT_TRUE(station.lens && station.photos && !station.camera && station.scale_bars.size() == 3);
    } else {
      ASSERT_TRUE(station.camera && station.prior && !station.lens);
      EXPECT_GT(station.camera->pose.center().norm(), 100);
    }
    ++count;
  }
  EXPECT_GE(count, 20);
}

}  // namespace
}  // namespace malus
