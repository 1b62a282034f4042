// Reconstructs a station whose coarse surface comes from sweeps of photographs with known poses. As in the front end,
// there are two sweeps: one around points, the second around the surface fused with the result of the first. For
// constants.py, which writes the files of FOLDER.
//
//     sweep-of-files STATION FOLDER WORKSPACE [section.key=value …]

#include <cmath>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <string>
#include <utility>
#include <vector>

#include "malus/station/reconstruct.h"
#include "malus/stereo/surface_sweep_internal.h"

namespace {

namespace fs = std::filesystem;

template <class T>
void read(const fs::path& path, T* values, std::size_t count) {
  std::ifstream file(path, std::ios::binary);
  file.read(reinterpret_cast<char*>(values), static_cast<std::streamsize>(count * sizeof(T)));
  if (!file) throw malus::Error(malus::ErrorCode::input, path.string() + ": too short");
}

malus::Image<float> read_image(const fs::path& path, malus::Size size) {
  malus::Image<float> image(size);
  read(path, image.data(), image.count());
  return image;
}

/// Reads the station's view and the photos. cameras.txt has a line for each: name, size, fx fy cx cy, rotation,
/// translation.
malus::SweepInput read_input(const fs::path& folder, std::vector<malus::SweepView>& views) {
  std::ifstream list(folder / "cameras.txt");
  malus::SweepInput input;
  std::string name;
  while (list >> name) {
    malus::SweepView view;
    view.camera.params.resize(4);
    list >> view.camera.size.width >> view.camera.size.height;
    for (double& value : view.camera.params) list >> value;
    for (int row = 0; row < 3; ++row)
      for (int column = 0; column < 3; ++column) list >> view.pose.rotation(row, column);
    for (int row = 0; row < 3; ++row) list >> view.pose.translation[row];
    view.intensity = read_image(folder / (name + ".f32"), view.camera.size);
    if (name != "station") {
      views.push_back(std::move(view));
      continue;
    }
    input.intensity = std::move(view.intensity);
    input.camera = view.camera.pinhole();
    input.pose = view.pose;
  }
  input.mask = malus::Mask(input.camera.size);
  read(folder / "mask.u8", input.mask.data(), input.mask.count());
  std::vector<double> points(fs::file_size(folder / "points.f64") / sizeof(double));
  read(folder / "points.f64", points.data(), points.size());
  for (std::size_t i = 0; i + 2 < points.size(); i += 3)
    input.points.emplace_back(points[i], points[i + 1], points[i + 2]);
  return input;
}

/// The fused surface, limited to the neighborhood of its prior, as in python/malus/photogrammetry/station_sweep.py.
malus::Image<float> held(const malus::FusedSurface& fused, const malus::DepthPrior& prior) {
  constexpr float trusted_sigmas = 2;
  malus::Image<float> shape = prior.depth;
  for (std::size_t i = 0; i < shape.count(); ++i) {
    const float reach = trusted_sigmas * prior.sigma[i], moved = fused.depth[i] - prior.depth[i];
    if (std::isfinite(moved) && std::isfinite(reach)) shape[i] += std::fmin(std::fmax(moved, -reach), reach);
  }
  return shape;
}

void run(const std::vector<std::string>& arguments) {
  const fs::path folder = arguments[1], work = arguments[2];
  malus::Options options;
  for (std::size_t i = 3; i < arguments.size(); ++i) malus::set_option(options, arguments[i]);
  malus::Station station = malus::Station::load(arguments[0]);
  std::vector<malus::SweepView> views;
  malus::SweepInput input = read_input(folder, views);
  const malus::Context context;

  malus::SweepResult swept = malus::sweep_surface(input, views, options.sweep, context);
  station.prior = malus::SweptDepth{swept.depth, swept.sigma, {}};
  malus::RunOptions how{.until = "fuse"};
  const malus::Results first = malus::reconstruct(station, options, how, context);
  const auto prior = first.get<malus::DepthPrior>();

  input.surface = held(*first.get<malus::FusedSurface>(), *prior);
  input.surface_sigma = prior->sigma;
  const malus::Image<float> shape = input.surface;
  swept = malus::sweep_surface(input, std::move(views), options.sweep, context);
  station.prior = malus::SweptDepth{std::move(swept.depth), std::move(swept.sigma), shape};
  how.workspace = work;
  how.known = &first;
  malus::reconstruct(station, options, how, context);
}

}  // namespace

int main(int count, char** values) {
  try {
    const std::vector<std::string> arguments(values + 1, values + count);
    if (arguments.size() < 3) throw malus::Error(malus::ErrorCode::input, "expected STATION FOLDER WORKSPACE");
    run(arguments);
    return 0;
  } catch (const malus::Error& error) {
    std::fprintf(stderr, "sweep-of-files: %s\n", error.what());
    return static_cast<int>(error.code());
  } catch (const std::exception& error) {
    std::fprintf(stderr, "sweep-of-files: %s\n", error.what());
    return 1;
  }
}
