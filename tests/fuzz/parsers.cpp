// Fuzzes every parser of users' files with libFuzzer. The name by which the program is called selects the target
// (fuzz_ply, fuzz_station, …). For any bytes, a parser must return or throw malus::Error, within time and memory
// bounded by the file's size.

#include <sanitizer/allocator_interface.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>
#include <vector>

#include "malus/capture/response_internal.h"
#include "malus/core/error.h"
#include "malus/io/colmap_model_internal.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/point_cloud_file_internal.h"
#include "malus/io/polarized_files_internal.h"
#include "malus/io/station_file_internal.h"
#include "malus/io/toml_json_internal.h"
#include "malus/io/workspace_internal.h"

namespace malus {
namespace {

namespace fs = std::filesystem;

/// Memory allocated by all threads: now, and the maximum since the current input began [bytes].
std::atomic<std::size_t> taken = 0, most_taken = 0;
/// Memory that the current input may take: a constant, a share of its size and, for images, a share of their pixels.
std::size_t allowed_bytes = 0;
constexpr std::size_t always_allowed = 64 << 20, allowed_per_byte = 10;
/// Per pixel: four double samples in one strip, and the three floats made from them.
constexpr std::size_t allowed_per_pixel = 4 * sizeof(double) + 3 * sizeof(float);

void on_allocation(const volatile void*, std::size_t size) {
  const std::size_t now = taken += size;
  for (std::size_t most = most_taken; now > most && !most_taken.compare_exchange_weak(most, now);) {
  }
}

void on_release(const volatile void* memory) {
  taken -= __sanitizer_get_allocated_size(memory);
}

/// Folder in shared memory for the files of this process.
const fs::path& folder() {
  static const fs::path path = [] {
    std::string name = "/dev/shm/malus-fuzz-XXXXXX";
    if (::mkdtemp(name.data()) == nullptr) std::abort();
    std::atexit([] { fs::remove_all(folder()); });
    return fs::path(name);
  }();
  return path;
}

fs::path write(const std::string& name, std::string_view bytes) {
  const fs::path path = folder() / name;
  std::ofstream(path, std::ios::binary).write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  return path;
}

/// The parts of the input, separated by lines of five equals signs.
std::vector<std::string_view> parts_of(std::string_view input) {
  constexpr std::string_view separator = "\n=====\n";
  std::vector<std::string_view> parts;
  for (std::size_t end = 0; (end = input.find(separator)) != std::string_view::npos;) {
    parts.push_back(input.substr(0, end));
    input.remove_prefix(end + separator.size());
  }
  parts.push_back(input);
  return parts;
}

/// Runs one reader. Any exception other than malus::Error ends the program.
template <class Read>
void attempt(Read&& read) {
  try {
    read();
  } catch (const Error&) {
  }
}

void read_colmap(std::string_view input, const std::string& extension) {
  const std::vector<std::string_view> parts = parts_of(input);
  const std::array<std::string, 3> names{"cameras", "images", "points3D"};
  for (std::size_t k = 0; k < names.size(); ++k) write(names[k] + extension, k < parts.size() ? parts[k] : "");
  attempt([] { read_colmap_model(folder()); });
}

void read_images(std::string_view input) {
  const fs::path path = write("image", input);
  attempt([&] { allowed_bytes += allowed_per_pixel * read_image_size(path).area(); });
  // Every reader decodes the whole image first, so only one runs per input, selected by the input's last byte.
  switch (input.empty() ? 0 : static_cast<unsigned char>(input.back()) % 3) {
    case 0:
      attempt([&] { read_float_raster(path); });
      break;
    case 1:
      attempt([&] { read_labels(path); });
      break;
    default:
      attempt([&] { read_mask(path); });
  }
}

/// Writes the files that the seeds of station files and object files name, once.
void require_inputs() {
  static const bool has_inputs = [] {
    for (const char* name : {"pol", "views", "masks"}) fs::create_directories(folder() / name);
    for (const char* name : {"pol/pol_000.png", "pol/pol_060.png", "pol/pol_120.png", "mask.png", "views/a.png",
                             "views/b.png", "masks/a.png", "masks/b.png"})
      write_png(folder() / name, Image<std::uint8_t>({8, 6}, 1, 255));
    write("response.txt", "0 0\n255 1\n");
    write("cloud.ply",
          "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
          "end_header\n0 0 1\n");
    return true;
  }();
  static_cast<void>(has_inputs);
}

void read_station(std::string_view input) {
  require_inputs();
  const fs::path path = write("station.toml", input);
  attempt([&] { read_station_file(path); });
}

/// The tables of an object file that are as in a station file.
void read_photos(std::string_view input) {
  require_inputs();
  const fs::path path = write("object.toml", input);
  attempt([&] { read_photos_tables(path); });
}

/// The input is a pattern and names to try it on.
void read_names(std::string_view input) {
  const std::vector<std::string_view> parts = parts_of(input);
  const std::string pattern(parts[0]);
  const std::vector<fs::path> names(parts.begin() + 1, parts.end());
  for (const fs::path& name : names) {
    attempt([&] { angle_of_name(name, pattern, "pattern"); });
    natural_less(pattern, name.string());
  }
  if (!names.empty()) attempt([&] { angles_of_names(names, "images", "otherwise"); });
  // A pattern that leaves the folder would search the machine's disk up to the time limit, a second each time. The
  // tests of limits cover such patterns.
  if (!pattern.starts_with('/') && pattern.find("..") == std::string::npos)
    attempt([&] { match_files(folder(), pattern, "images"); });
}

struct Target {
  std::string_view name;
  void (*read)(std::string_view input);
};

constexpr std::array targets{
    Target{"ply", [](std::string_view input) { attempt([&] { read_cloud_or_mesh(write("cloud.ply", input)); }); }},
    Target{"xyz", [](std::string_view input) { attempt([&] { read_point_cloud(write("cloud.xyz", input)); }); }},
    Target{"toml",
           [](std::string_view input) { attempt([&] { read_toml_as_json(write("o.toml", input), "options file"); }); }},
    Target{"station", read_station},
    Target{"photos", read_photos},
    Target{"response", [](std::string_view input) { attempt([&] { read_response_table(write("r.txt", input)); }); }},
    Target{"colmap_text", [](std::string_view input) { read_colmap(input, ".txt"); }},
    Target{"colmap_binary", [](std::string_view input) { read_colmap(input, ".bin"); }},
    Target{"colmap_map", [](std::string_view input) { attempt([&] { read_colmap_array(write("map.bin", input)); }); }},
    Target{"image", read_images},
    Target{"manifest",
           [](std::string_view input) {
             write("manifest.json", input);
             attempt([] { Workspace::read_manifest(folder()); });
           }},
    Target{"names", read_names},
};

const Target* target = nullptr;

}  // namespace
}  // namespace malus

extern "C" int LLVMFuzzerInitialize(int*, char*** arguments) {
  __sanitizer_install_malloc_and_free_hooks(malus::on_allocation, malus::on_release);
  const std::string program = std::filesystem::path((*arguments)[0]).filename();
  for (const malus::Target& candidate : malus::targets) {
    if (program == "fuzz_" + std::string(candidate.name)) malus::target = &candidate;
  }
  if (malus::target != nullptr) return 0;
  std::fprintf(stderr, "%s: no target has that name\n", program.c_str());
  std::exit(2);
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace malus;
  const std::size_t before = taken;
  most_taken = before;
  allowed_bytes = always_allowed + allowed_per_byte * size;
  target->read({reinterpret_cast<const char*>(data), size});
  const std::size_t grown = most_taken - before;
  if (grown <= allowed_bytes) return 0;
  std::fprintf(stderr, "%zu bytes took %zu of memory, allowed: %zu\n", size, grown, allowed_bytes);
  std::abort();
}
