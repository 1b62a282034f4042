#include <sys/mount.h>

#include <algorithm>
#include <string>

#include "malus/io/atomic_file_internal.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/input_file_internal.h"
#include "malus/io/record_writer_internal.h"
#include "malus/io/sha256_internal.h"
#include "temporary_folder.h"
#include "thrown_error.h"

namespace malus {
namespace {

std::size_t files_in(const std::filesystem::path& folder) {
  return static_cast<std::size_t>(
      std::distance(std::filesystem::directory_iterator(folder), std::filesystem::directory_iterator()));
}

TEST(AtomicFile, AppearsOnlyWhenCommitted) {
  const TemporaryFolder folder;
  const auto path = folder / "result.txt";
  {
    AtomicFile file(path);
    file.write("first");
    EXPECT_FALSE(std::filesystem::exists(path));
  }
  EXPECT_EQ(files_in(folder.path()), 0u) << "the temporary file of an abandoned write is removed";
  write_file(path, "second");
  EXPECT_EQ(read_file(path, "result"), "second");
  EXPECT_EQ(files_in(folder.path()), 1u);
}

TEST(AtomicFile, AbandonedWriteKeepsTheOldFile) {
  const TemporaryFolder folder;
  const auto path = folder.write("result.txt", "old");
  {
    AtomicFile file(path);
    file.write("new");
  }
  EXPECT_EQ(read_file(path, "result"), "old");
}

TEST(AtomicFile, PartsMayBeWrittenInAnyOrder) {
  const TemporaryFolder folder;
  AtomicFile file(folder / "parts");
  file.write("head ");
  file.write_at(9, "tail", 4);
  file.write_at(5, "mid ", 4);
  file.commit();
  EXPECT_EQ(read_file(folder / "parts", "parts"), "head mid tail");
}

TEST(AtomicFile, ReservedSpaceIsFilledByWrites) {
  const TemporaryFolder folder;
  const auto path = folder / "result.txt";
  AtomicFile file(path);
  file.expect(6);
  file.write("abc");
  file.write_at(3, "def", 3);
  file.commit();
  EXPECT_EQ(read_file(path, "result"), "abcdef");
}

TEST(AtomicFile, RecordsAreWrittenByAllThreadsAndHashedPieceByPiece) {
  // 3 MB are several pieces for both the writer and the hash. The sizes of header and record divide neither piece.
  constexpr std::size_t header = 301, record = 27, count = 110'000;
  const TemporaryFolder folder;
  const auto path = folder / "records";
  const auto byte_of = [](std::size_t at) { return static_cast<char>(at % 251 + at / 4096 % 7); };
  const Context context{.threads = 3};
  AtomicFile file(path);
  file.expect(header + count * record);
  file.write(std::string(header, '#'));
  write_records(file, header, count, record, context, [&](std::size_t i, FileBlock& block) {
    for (std::size_t k = 0; k < record; ++k) block.put(byte_of(i * record + k));
  });
  file.commit();
  const std::string written = read_file(path, "records");
  ASSERT_EQ(written.size(), header + count * record);
  EXPECT_EQ(written.substr(0, header), std::string(header, '#'));
  std::size_t wrong = 0;
  for (std::size_t i = 0; i < count * record; ++i) wrong += written[header + i] != byte_of(i);
  EXPECT_EQ(wrong, 0U);
  EXPECT_EQ(sha256_of_file(path, "records"), sha256_of_bytes(written));
}

TEST(AtomicFile, WrongPlaceIsAnInputErrorWithPathAndReason) {
  const TemporaryFolder folder;
  expect_error(
      ErrorCode::input, [&] { AtomicFile file(folder / "absent/x.txt"); }, "absent/x.txt", "No such file");
  expect_error(
      ErrorCode::input, [&] { AtomicFile file(folder.path()); }, "Is a directory");
  folder.write("file", "x");
  expect_error(
      ErrorCode::input, [&] { create_folder(folder / "file/below"); }, "file/below", "Not a directory");
  expect_error(
      ErrorCode::input, [&] { create_folder("/proc/malus"); }, "/proc/malus");
  create_folder(folder / "a/b");
  create_folder(folder / "a/b");
  EXPECT_TRUE(std::filesystem::is_directory(folder / "a/b"));
}

TEST(AtomicFile, FolderWithoutPermissionIsAnInputError) {
  if (::geteuid() == 0) GTEST_SKIP() << "permissions do not apply to root";
  const TemporaryFolder folder;
  create_folder(folder / "locked");
  std::filesystem::permissions(folder / "locked",
                               std::filesystem::perms::owner_read | std::filesystem::perms::owner_exec);
  expect_error(
      ErrorCode::input, [&] { AtomicFile file(folder / "locked/x"); }, "Permission denied");
  expect_error(
      ErrorCode::input, [&] { create_folder(folder / "locked"); }, "Permission denied");
}

TEST(AtomicFile, FullDiskIsAResourceErrorAndLeavesNothing) {
  const TemporaryFolder folder;
  const auto disk = folder / "disk";
  create_folder(disk);
  if (::mount("tmpfs", disk.c_str(), "tmpfs", 0, "size=256k") != 0) GTEST_SKIP() << "mounting is not permitted";
  const std::string large(1 << 20, 'x');
  expect_error(
      ErrorCode::resource, [&] { write_file(disk / "large.bin", large); }, "large.bin", "No space left");
  EXPECT_EQ(files_in(disk), 0u);
  expect_error(
      ErrorCode::resource,
      [&] {
        write_float_tiff(disk / "depth.tif", Image<float>({512, 512}));
      },
      "depth.tif", "No space left");
  Image<std::uint16_t> noise({512, 512});
  unsigned state = 1;
  for (auto& value : noise) value = static_cast<std::uint16_t>((state = state * 1664525u + 1013904223u) >> 16);
  expect_error(
      ErrorCode::resource, [&] { write_png16(disk / "noise.png", noise); }, "noise.png", "No space left");
  EXPECT_EQ(files_in(disk), 0u);
  ::umount(disk.c_str());
}

TEST(InputFile, ReadsLinesAcrossBufferBordersAndKeepsCount) {
  const TemporaryFolder folder;
  const std::string longline(3'000'000, 'y');
  const auto path = folder.write("lines.txt", "one\r\n\n" + longline + "\nlast");
  InputFile file(path, "list");
  std::string_view line;
  ASSERT_TRUE(file.read_line(line));
  EXPECT_EQ(line, "one");
  ASSERT_TRUE(file.read_line(line));
  EXPECT_EQ(line, "");
  ASSERT_TRUE(file.read_line(line));
  EXPECT_EQ(line, longline);
  ASSERT_TRUE(file.read_line(line));
  EXPECT_EQ(line, "last");
  EXPECT_EQ(file.line_number(), 4u);
  EXPECT_EQ(file.remaining(), 0u);
  EXPECT_FALSE(file.read_line(line));
}

TEST(InputFile, SmallAndLargeReadsCanAlternate) {
  TemporaryFolder folder;
  std::string bytes;
  for (int i = 0; i < 700'000; ++i) bytes += std::to_string(i) + '\n';
  const auto path = folder.write("numbers", bytes);
  InputFile file(path, "numbers");
  std::string got;
  std::size_t part = 5;
  while (got.size() < bytes.size()) {
    std::string next(std::min(part, bytes.size() - got.size()), '\0');
    file.read(next.data(), next.size());
    got += next;
    EXPECT_EQ(file.remaining(), bytes.size() - got.size());
    part = part * 7 % 3'000'017;
  }
  EXPECT_TRUE(got == bytes);
  EXPECT_TRUE(file.buffered().empty());
  const auto whole = read_bytes(path, "numbers");
  EXPECT_TRUE(std::equal(whole.begin(), whole.end(), bytes.begin(), bytes.end()));
}

TEST(InputFile, ErrorsNamePurposePathAndReason) {
  const TemporaryFolder folder;
  expect_error(
      ErrorCode::input, [&] { require_file(folder / "none", "cloud"); }, "cloud", "none", "no such file");
  expect_error(
      ErrorCode::input, [&] { require_file(folder.path(), "cloud"); }, "is a folder");
  expect_error(
      ErrorCode::input, [&] { require_file(folder.write("empty", ""), "cloud"); }, "is empty");
  expect_error(
      ErrorCode::input, [&] { require_file("/dev/null", "cloud"); }, "not a regular file");
  char bytes[8];
  InputFile file(folder.write("short", "abc"), "cloud");
  expect_error(
      ErrorCode::input, [&] { file.read(bytes, 8); }, "truncated");
}

}  // namespace
}  // namespace malus
