// Writes a mesh of SIDE × SIDE vertices as PLY and GLB into FOLDER with THREADS threads, and copies each file by `cp`
// and `sync`. Prints megabytes per second of each step as a JSON line. The writers sync their files, too.
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <stdexcept>
#include <string>

#include "malus/io/glb_file_internal.h"
#include "malus/io/ply_writer_internal.h"

using namespace malus;

namespace {

TriangleMesh make_mesh(int side) {
  TriangleMesh mesh;
  for (int v = 0; v < side; ++v) {
    for (int u = 0; u < side; ++u) {
      mesh.vertices.points.emplace_back(0.1 * u, 0.1 * v, 400 + std::sin(0.01 * u) * std::cos(0.02 * v));
      mesh.vertices.normals.push_back(Eigen::Vector3f(0.1F, 0, -1).normalized());
    }
  }
  const auto row = static_cast<std::uint32_t>(side);
  for (std::uint32_t v = 0; v + 1 < row; ++v) {
    for (std::uint32_t u = 0; u + 1 < row; ++u) {
      const std::uint32_t at = v * row + u;
      mesh.triangles.push_back({at, at + row, at + 1});
      mesh.triangles.push_back({at + 1, at + row, at + row + 1});
    }
  }
  return mesh;
}

template <class Work>
double seconds_of(Work&& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

/// Two JSON fields with the MB/s of writing and of copying; removes both files.
template <class Write>
std::string measure(const std::filesystem::path& path, Write&& write) {
  const double written = seconds_of(write);
  const std::string copy = path.string() + ".copy";
  const std::string command = "cp '" + path.string() + "' '" + copy + "' && sync '" + copy + "'";
  const double copied = seconds_of([&] {
    if (std::system(command.c_str()) != 0) throw std::runtime_error(command + " failed");
  });
  const double megabytes = static_cast<double>(std::filesystem::file_size(path)) / 1e6;
  std::filesystem::remove(path);
  std::filesystem::remove(copy);
  const std::string name = path.extension().string().substr(1);
  return '"' + name + "_written_mb_s\": " + std::to_string(megabytes / written) + ", \"" + name +
         "_copied_mb_s\": " + std::to_string(megabytes / copied);
}

}  // namespace

int main(int count, char** arguments) {
  if (count != 4) {
    std::cerr << "usage: mesh_files SIDE FOLDER THREADS\n";
    return 2;
  }
  const int side = std::stoi(arguments[1]);
  const std::filesystem::path folder = arguments[2];
  const Context context{.threads = std::stoi(arguments[3])};
  const TriangleMesh mesh = make_mesh(side);
  const Image<std::uint8_t> photograph({256, 256}, 1, 128);
  const Pinhole camera{{256, 256}, 1000, 1000, 128, 128};
  const Pose pose;
  std::cout << "{" << measure(folder / "mesh.ply", [&] {
    write_ply(folder / "mesh.ply", mesh, context);
  }) << ", " << measure(folder / "mesh.glb", [&] {
    write_glb(folder / "mesh.glb", mesh, {photograph, camera, pose}, length_unit("mm"), "mesh", context);
  }) << "}\n";
}
