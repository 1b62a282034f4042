#include "malus/io/workspace.h"

#include <sys/wait.h>
#include <unistd.h>

#include <nlohmann/json.hpp>
#include <stdexcept>

#include "malus/io/input_file.h"
#include "malus/io/sha256.h"
#include "temporary_folder.h"

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

TEST(Workspace, RemembersFinishedStepsAcrossRuns) {
  const TemporaryFolder folder;
  const auto path = folder / "work/deep";
  {
    Workspace workspace(path);
    EXPECT_FALSE(workspace.is_done("prior", "key"));
    EXPECT_EQ(workspace.notes("prior"), "{}");
    workspace.begin("prior");
    EXPECT_FALSE(workspace.is_done("prior", "key"));
    folder.write("work/deep/prior/depth.tif", "1234");
    workspace.finish("prior", "key", {workspace.examine("prior/depth.tif")}, {1.5, 2.5, 100},
                     R"({"b": 2.5, "a": [1]})");
    workspace.set_info("options", R"({"x": 1})");
  }
  {
    const Workspace workspace(path);
    EXPECT_EQ(workspace.folder(), path);
    EXPECT_TRUE(workspace.is_done("prior", "key"));
    EXPECT_FALSE(workspace.is_done("prior", "other key"));
    EXPECT_FALSE(workspace.is_done("height", "key"));
    EXPECT_EQ(workspace.notes("prior"), R"({"a":[1],"b":2.5})");
  }
  const nlohmann::json manifest = manifest_of(path);
  EXPECT_EQ(manifest["options"]["x"], 1);
  EXPECT_EQ(manifest["steps"]["prior"]["outputs"]["prior/depth.tif"]["size"], 4);
  EXPECT_EQ(manifest["steps"]["prior"]["outputs"]["prior/depth.tif"]["sha256"], sha256_of_bytes("1234"));
  EXPECT_EQ(manifest["times"]["prior"]["seconds"], 1.5);
  EXPECT_EQ(manifest["times"]["prior"]["cpu_seconds"], 2.5);
  EXPECT_EQ(manifest["times"]["prior"]["peak_mb"], 100);
}

TEST(Workspace, MissingOrChangedOutputsAreNotDone) {
  const TemporaryFolder folder;
  Workspace workspace(folder.path());
  folder.write("a.tif", "1234");
  workspace.finish("step", "key", {workspace.examine("a.tif")}, {});
  EXPECT_TRUE(workspace.is_done("step", "key"));
  folder.write("a.tif", "12345");
  EXPECT_FALSE(workspace.is_done("step", "key"));
  std::filesystem::remove(folder / "a.tif");
  EXPECT_FALSE(workspace.is_done("step", "key"));
  expect_error(
      ErrorCode::input, [&] { workspace.finish("step", "key", {workspace.examine("a.tif")}, {}); }, "output", "a.tif");
}

TEST(Workspace, BeginRemovesTheMarkOnDisk) {
  const TemporaryFolder folder;
  folder.write("a.tif", "1234");
  {
    Workspace workspace(folder.path());
    workspace.finish("step", "key", {workspace.examine("a.tif")}, {});
    workspace.begin("step");
  }
  EXPECT_FALSE(Workspace(folder.path()).is_done("step", "key")) << "as after a run that died in the step";
}

TEST(Workspace, EqualRunsDifferOnlyInTimes) {
  const TemporaryFolder a, b;
  for (const TemporaryFolder* folder : {&a, &b}) {
    folder->write("x", "1");
    folder->write("y", "2");
    Workspace workspace(folder->path());
    const bool first = folder == &a;
    workspace.finish(first ? "one" : "two", "k", {workspace.examine(first ? "x" : "y")}, {first ? 1.0 : 2.0});
    workspace.finish(first ? "two" : "one", "k", {workspace.examine(first ? "y" : "x")}, {first ? 3.0 : 4.0});
  }
  nlohmann::json one = manifest_of(a.path()), two = manifest_of(b.path());
  EXPECT_NE(one["times"], two["times"]);
  one.erase("times");
  two.erase("times");
  EXPECT_EQ(one.dump(), two.dump());
}

TEST(Workspace, TwoRunsInOneFolderAreRefused) {
  const TemporaryFolder folder;
  {
    const Workspace first(folder.path());
    expect_error(
        ErrorCode::input, [&] { Workspace second(folder.path()); }, folder.path().string(), "in use by another run");
  }
  const Workspace again(folder.path());
}

TEST(Workspace, LockEndsWithTheProcess) {
  const TemporaryFolder folder;
  const pid_t child = ::fork();
  if (child == 0) {
    new Workspace(folder.path());  // never destroyed: the process dies while it holds the lock
    ::_exit(0);
  }
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
  const Workspace workspace(folder.path());
}

TEST(Workspace, DamagedManifestSaysWhatToDo) {
  const TemporaryFolder folder;
  folder.write("a.tif", "1234");
  {
    Workspace workspace(folder.path());
    workspace.finish("step", "key", {workspace.examine("a.tif")}, {});
  }
  const std::string good = read_file(folder / "manifest.json", "manifest");
  for (
      const std::string& bad :
      {std::string(), good.substr(0, good.size() / 2), std::string("[]"), std::string("{}"),
       std::string(R"({"format": 99, "steps": {}, "times": {}})"),
       std::string(R"({"format": 1, "steps": {"a": 1}, "times": {}})"),
       std::string(
           R"({"format": 1, "steps": {"a": {"status": "done", "key": "k", "outputs": {"x": {}}, "notes": {}}}, "times": {}})")}) {
    folder.write("manifest.json", bad);
    expect_error(
        ErrorCode::input, [&] { Workspace workspace(folder.path()); }, "manifest.json", "delete it");
  }
}

TEST(Workspace, UnusableFolders) {
  const TemporaryFolder folder;
  folder.write("file", "x");
  expect_error(
      ErrorCode::input, [&] { Workspace workspace(folder / "file"); }, "file", "Not a directory");
  expect_error(
      ErrorCode::input, [&] { Workspace workspace("/proc/malus"); }, "/proc/malus");
  Workspace workspace(folder.path());
  EXPECT_THROW(workspace.set_info("steps", "{}"), std::invalid_argument);
  EXPECT_THROW(workspace.set_info("options", "{"), std::invalid_argument);
}

}  // namespace
}  // namespace malus
