#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "malus/io/input_file_internal.h"
#include "malus/io/sha256_internal.h"
#include "malus/io/workspace_internal.h"
#include "temporary_folder.h"
#include "thrown_error.h"

namespace malus {
namespace {

nlohmann::json manifest_of(const std::filesystem::path& folder) {
  return nlohmann::json::parse(read_file(folder / "manifest.json", "manifest"));
}

// Test vectors of FIPS 180-4 (NIST's examples for SHA-256).
TEST(Sha256, PublishedVectors) {
  EXPECT_EQ(sha256_of_bytes(""), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  EXPECT_EQ(sha256_of_bytes("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  const TemporaryFolder folder;
  const std::string million(1'000'000, 'a');
  EXPECT_EQ(sha256_of_file(folder.write("a", million), "input"),
            "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
  const std::string large(3'500'001, 'b');
  EXPECT_EQ(sha256_of_file(folder.write("b", large), "input"), sha256_of_bytes(large)) << "longer than one buffer";
  expect_error(
      ErrorCode::input, [&] { sha256_of_file(folder / "none", "input"); }, "input", "no such file");
}

const Workspace::Owner owner{"relief", "/stations/relief/station.toml"};

Workspace::Record record_of(const Workspace& workspace, const std::string& key, const std::vector<std::string>& files) {
  Workspace::Record record;
  record.key = key;
  record.outputs = workspace.examine(files, {});
  return record;
}

TEST(Workspace, RemembersFinishedStepsAcrossRuns) {
  const TemporaryFolder folder;
  const auto path = folder / "work/deep";
  {
    Workspace workspace(path, owner, false);
    EXPECT_EQ(workspace.record("prior"), nullptr);
    folder.write("work/deep/prior/depth.tif", "1234");
    Workspace::Record record = record_of(workspace, "key", {"prior/depth.tif"});
    record.inputs = {{"cloud.ply", "abc"}};
    record.options = {{"prior", {{"x", 2}}}};
    record.warnings = {"too few points"};
    record.notes = {{"b", 2.5}, {"a", {1}}};
    workspace.set_info("options", {{"prior", {{"x", 1}}}, {"refine", 3}});
    workspace.finish("prior", record, {{"seconds", 1.5}});
    workspace.set_times("photos", {{"seconds", 9}});
  }
  {
    const Workspace workspace(path, owner, false);
    EXPECT_EQ(workspace.folder(), path);
    const Workspace::Record* record = workspace.record("prior");
    ASSERT_NE(record, nullptr);
    EXPECT_EQ(record->key, "key");
    EXPECT_EQ(record->warnings, std::vector<std::string>{"too few points"});
    EXPECT_EQ(record->notes["b"], 2.5);
    EXPECT_TRUE(workspace.changed_since("prior", {}).empty());
    EXPECT_EQ(workspace.record("height"), nullptr);
  }
  const nlohmann::json manifest = manifest_of(path);
  EXPECT_EQ(manifest["station"]["name"], "relief");
  EXPECT_EQ(manifest["inputs"]["cloud.ply"], "abc");
  EXPECT_EQ(manifest["options"]["prior"]["x"], 2) << "the option of the step, not of the last run";
  EXPECT_EQ(manifest["options"]["refine"], 3);
  EXPECT_EQ(manifest["steps"]["prior"]["outputs"]["prior/depth.tif"]["size"], 4);
  EXPECT_EQ(manifest["steps"]["prior"]["outputs"]["prior/depth.tif"]["sha256"], sha256_of_bytes("1234"));
  EXPECT_EQ(manifest["times"]["prior"]["seconds"], 1.5);
  EXPECT_EQ(manifest["times"]["photos"]["seconds"], 9);
  EXPECT_EQ(Workspace::read_manifest(path)["steps"].size(), 1u);
}

TEST(Workspace, DetectsChangedFilesAndRecords) {
  const TemporaryFolder folder;
  const auto changed = [&] { return Workspace(folder.path(), owner, false).changed_since("step", {}); };
  {
    Workspace workspace(folder.path(), owner, false);
    folder.write("a.tif", "1234");
    folder.write("b.tif", "5");
    workspace.finish("step", record_of(workspace, "key", {"a.tif", "b.tif"}), {});
  }
  EXPECT_TRUE(changed().empty());
  folder.write("a.tif", "1294");
  EXPECT_EQ(changed(), std::vector<std::string>{"a.tif"}) << "one byte differs";
  folder.write("a.tif", "12345");
  EXPECT_EQ(changed(), std::vector<std::string>{"a.tif"});
  std::filesystem::remove(folder / "a.tif");
  EXPECT_EQ(changed(), std::vector<std::string>{"a.tif"});
  folder.write("a.tif", "1234");
  EXPECT_TRUE(changed().empty());

  for (const char* field : {"notes", "warnings", "key"}) {
    nlohmann::json manifest = manifest_of(folder.path());
    manifest["steps"]["step"][field] =
        manifest["steps"]["step"][field].is_string() ? nlohmann::json("other") : nlohmann::json::array({"other"});
    const std::string before = read_file(folder / "manifest.json", "manifest");
    folder.write("manifest.json", manifest.dump());
    EXPECT_EQ(changed(), std::vector<std::string>{"manifest.json"}) << field;
    expect_error(
        ErrorCode::input, [&] { Workspace::read_manifest(folder.path()); }, "manifest.json", "step");
    folder.write("manifest.json", before);
  }
  const Workspace workspace(folder.path(), owner, false);
  expect_error(
      ErrorCode::input, [&] { workspace.examine({"c.tif"}, {}); }, "output", "c.tif");
}

TEST(Workspace, ForgetRemovesRecordsAndFiles) {
  const TemporaryFolder folder;
  {
    Workspace workspace(folder.path(), owner, false);
    for (const char* name : {"deep/old.tif", "mine.txt"}) folder.write(name, "1");
    const auto finish = [&](const char* step, const char* file, const std::map<std::string, std::string>& after) {
      folder.write(file, "1");
      Workspace::Record record = record_of(workspace, "key", {file});
      record.after = after;
      workspace.finish(step, record, {});
    };
    finish("one", "a.tif", {});
    finish("two", "b.tif", {});
    finish("last", "c.tif", {{"after one", "key"}, {"two", "key"}});
    finish("after one", "d.tif", {{"one", "key"}});
    workspace.forget("one", {"deep/old.tif", "deep/none.tif"});
  }
  const Workspace workspace(folder.path(), owner, false);
  EXPECT_EQ(workspace.record("one"), nullptr) << "as after a run that failed in this step";
  EXPECT_NE(workspace.record("two"), nullptr);
  EXPECT_EQ(workspace.record("after one"), nullptr);
  EXPECT_EQ(workspace.record("last"), nullptr);
  for (const char* name : {"a.tif", "c.tif", "d.tif"}) EXPECT_FALSE(std::filesystem::exists(folder / name)) << name;
  EXPECT_FALSE(std::filesystem::exists(folder / "deep/old.tif"));
  EXPECT_TRUE(std::filesystem::exists(folder / "b.tif"));
  EXPECT_TRUE(std::filesystem::exists(folder / "mine.txt"));
}

TEST(Workspace, EqualRunsDifferOnlyInTimes) {
  const TemporaryFolder a, b;
  for (const TemporaryFolder* folder : {&a, &b}) {
    Workspace workspace(folder->path(), {"same", {}}, false);
    folder->write("x", "1");
    folder->write("y", "2");
    const bool first = folder == &a;
    const auto finish = [&](bool one) {
      workspace.finish(one ? "one" : "two", record_of(workspace, "k", {one ? "x" : "y"}), {{"seconds", first ? 1 : 2}});
    };
    finish(first);
    finish(!first);
  }
  nlohmann::json one = manifest_of(a.path()), two = manifest_of(b.path());
  EXPECT_NE(one["times"], two["times"]);
  one.erase("times");
  two.erase("times");
  EXPECT_EQ(one.dump(), two.dump());
}

TEST(Workspace, BelongsToOneStation) {
  const TemporaryFolder folder;
  const std::filesystem::path work = folder / "a/work";
  const Workspace::Owner a{"a", folder / "a/station.toml"}, b{"b", folder / "b/station.toml"};
  { const Workspace workspace(work, a, false); }
  { const Workspace same_file(work, {"renamed", a.file}, false); }
  expect_error(
      ErrorCode::input, [&] { Workspace(work, b, false); }, work.string(), "belongs to station \"renamed\"",
      a.file.string(), "--replace");
  expect_error(
      ErrorCode::input,
      [&] {
        Workspace(work, {"renamed", {}}, false);
      },
      "belongs to");
  std::filesystem::rename(folder / "a", folder / "c");
  { const Workspace moved_with_its_station(folder / "c/work", {"renamed", folder / "c/station.toml"}, false); }
  { const Workspace taken_over(folder / "c/work", b, true); }
  expect_error(
      ErrorCode::input, [&] { Workspace(folder / "c/work", a, false); }, "belongs to station \"b\"");

  { const Workspace in_code(folder / "code", {"a", {}}, false); }
  { const Workspace again(folder / "code", {"a", {}}, false); }
  expect_error(
      ErrorCode::input,
      [&] {
        Workspace(folder / "code", {"other", {}}, false);
      },
      "belongs to station \"a\";");
}

TEST(Workspace, RefusesAFolderWithOtherFiles) {
  const TemporaryFolder folder;
  folder.write("thesis.doc", "1");
  for (const bool replace : {false, true}) {
    expect_error(
        ErrorCode::input, [&] { Workspace(folder.path(), owner, replace); }, folder.path().string(),
        "not empty and not a workspace", (folder / "work").string());
  }
  std::filesystem::remove(folder / "thesis.doc");
  folder.write("manifest.json", R"({"@context": "http://iiif.io/api/presentation/3/context.json", "items": []})");
  for (const bool replace : {false, true}) {
    expect_error(
        ErrorCode::input, [&] { Workspace(folder.path(), owner, replace); }, "not empty and not a workspace");
  }
  std::filesystem::remove(folder / "manifest.json");
  folder.write(".DS_Store", "1");
  const Workspace workspace(folder.path(), owner, false);
}

TEST(Workspace, TwoRunsInOneFolderAreRefused) {
  const TemporaryFolder folder;
  {
    const Workspace first(folder.path(), owner, false);
    expect_error(
        ErrorCode::input, [&] { Workspace second(folder.path(), owner, false); }, folder.path().string(),
        "in use by another run");
  }
  const Workspace again(folder.path(), owner, false);
}

TEST(Workspace, LockEndsWithTheProcess) {
  const TemporaryFolder folder;
  const pid_t child = ::fork();
  if (child == 0) {
    new Workspace(folder.path(), owner, false);  // never destroyed: the process dies while it holds the lock
    ::_exit(0);
  }
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
  const Workspace workspace(folder.path(), owner, false);
}

TEST(Workspace, LockEndsThoughAForkedChildLives) {
  const TemporaryFolder folder;
  pid_t child = -1;
  {
    const Workspace workspace(folder.path(), owner, false);
    child = ::fork();
    if (child == 0) {
      for (;;) ::pause();  // as a worker process that another thread of the program started
    }
  }
  EXPECT_NO_THROW(Workspace(folder.path(), owner, false));
  ::kill(child, SIGKILL);
  EXPECT_EQ(::waitpid(child, nullptr, 0), child);
}

TEST(Workspace, DamagedManifestSaysWhatToDo) {
  const TemporaryFolder folder;
  {
    Workspace workspace(folder.path(), owner, false);
    folder.write("a.tif", "1234");
    workspace.finish("step", record_of(workspace, "key", {"a.tif"}), {});
  }
  const std::string good = read_file(folder / "manifest.json", "manifest");
  nlohmann::json outside = nlohmann::json::parse(good);
  outside["steps"]["step"]["outputs"]["../a.tif"] = outside["steps"]["step"]["outputs"]["a.tif"];
  for (const std::string& bad :
       {std::string(), good.substr(0, good.size() / 2), std::string("[]"), std::string("{}"),
        std::string(R"({"format": 1, "steps": {}, "times": {}})"),
        std::string(R"({"format": 2, "station": {}, "steps": {"a": 1}, "times": {}})"),
        std::string(R"({"format": 2, "station": {}, "steps": {"a": {"key": "k", "outputs": {"x": {}}}}, "times": {}})"),
        outside.dump()}) {
    folder.write("manifest.json", bad);
    expect_error(
        ErrorCode::input, [&] { Workspace workspace(folder.path(), owner, false); }, "manifest.json", "--replace");
    const Workspace anew(folder.path(), owner, true);
    EXPECT_EQ(anew.record("step"), nullptr);
  }
}

TEST(Workspace, UnusableFoldersAreRefused) {
  const TemporaryFolder folder;
  folder.write("file", "x");
  expect_error(
      ErrorCode::input, [&] { Workspace workspace(folder / "file", owner, false); }, "file", "Not a directory");
  expect_error(
      ErrorCode::input, [&] { Workspace workspace("/proc/malus", owner, false); }, "/proc/malus");
  expect_error(
      ErrorCode::input, [&] { Workspace workspace(folder.path()); }, "not a workspace of malus");
  expect_error(
      ErrorCode::input, [&] { Workspace::read_manifest(folder.path()); }, "not a workspace of malus");
  Workspace workspace(folder / "work", owner, false);
  EXPECT_THROW(workspace.set_info("steps", {}), std::invalid_argument);
}

}  // namespace
}  // namespace malus
