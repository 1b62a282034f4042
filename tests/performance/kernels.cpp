// Runs the kernels whose speed is promised, one after the other, on small inputs and one thread. tests/performance/run
// counts their instructions under callgrind. Making inputs and checking results is not counted.
//   performance_kernels FOLDER
// FOLDER receives the files that the kernels write.
#include <valgrind/callgrind.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <iostream>
#include <numbers>
#include <stdexcept>
#include <string>
#include <vector>

#include "capture/scenes.h"
#include "fusion/synthetic_station.h"
#include "height/height_scenes.h"
#include "linalg/height_like_system.h"
#include "malus/capture/registration_internal.h"
#include "malus/fusion/refine_internal.h"
#include "malus/height/height_internal.h"
#include "malus/io/glb_file_internal.h"
#include "malus/io/ply_writer_internal.h"
#include "malus/linalg/grid_solver_internal.h"
#include "malus/polarization/decompose_internal.h"
#include "malus/polarization/reflection_internal.h"
#include "malus/prior/project_prior_internal.h"
#include "malus/prior/visible_points_internal.h"
#include "malus/stereo/surface_sweep_internal.h"
#include "malus/surface/mesh.h"
#include "prior/cloud_scenes.h"
#include "stereo/sweep_scenes.h"
#include "surface/scenes.h"

using namespace malus;

namespace {

const Context one_thread;

/// Counts the instructions of work() under this name. Throws if work() returns false: a kernel that gives up early
/// takes few instructions.
template <class Work>
void count(const char* kernel, Work&& work) {
  CALLGRIND_START_INSTRUMENTATION;
  CALLGRIND_ZERO_STATS;
  const bool good = work();
  CALLGRIND_DUMP_STATS_AT(kernel);
  CALLGRIND_STOP_INSTRUMENTATION;
  if (!good) throw std::runtime_error(std::string(kernel) + ": the result is not what it should be");
}

void sinusoid_fit_and_zenith() {
  const Size size{512, 384};
  std::vector<double> angles;
  std::vector<Image<std::uint16_t>> images;
  std::vector<const std::uint16_t*> pixels;
  for (int k = 0; k < 6; ++k) {
    const double angle = k * std::numbers::pi / 6;
    angles.push_back(angle);
    Image<std::uint16_t>& image = images.emplace_back(size);
    for (int v = 0; v < size.height; ++v) {
      for (int u = 0; u < size.width; ++u) {
        const double degree = 0.15 + 0.14 * std::sin(0.02 * u + 0.01 * v), phase = 0.01 * u - 0.02 * v;
        const double noise = (u * 7 + v * 13 + k * 5) % 17 - 8;
        image(u, v) = static_cast<std::uint16_t>(20000 * (1 + degree * std::cos(2 * (angle - phase))) + noise);
      }
    }
  }
  for (const Image<std::uint16_t>& image : images) pixels.push_back(image.data());
  PolarizationState state;
  count("sinusoid fit, 16 bit", [&] {
    state = decompose(size, pixels, angles, {}, Mask(size, 1, 255), {}, {}, one_thread);
    return state.is_valid(100, 100);
  });
  const Pinhole camera = scenes::centerd_camera(size, 2000);
  for (const bool specular : {false, true}) {
    ReflectionOptions options;
    options.reflection = specular ? ReflectionChoice::specular : ReflectionChoice::diffuse;
    count(specular ? "zenith, specular" : "zenith, diffuse", [&] {
      return std::isfinite(map_reflection(state, &camera, nullptr, nullptr, options, one_thread).zenith(100, 100));
    });
  }
}

void registration() {
  const Size size{360, 240};
  const Affine map = similarity(size, 0.004, 1.003, 1.3, -0.7);
  const std::vector<Image<float>> images{AnalyticScene{}.image(size, identity_affine(), 0),
                                         AnalyticScene{}.image(size, map, std::numbers::pi / 4)};
  count("registration",
        [&] { return register_images(images, NoiseModel{}, {}, one_thread)[1].status == RegistrationStatus::ok; });
}

void grid_system() {
  constexpr int side = 112;
  const PixelIndex pixels(Mask({side, side}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  count("CHOLMOD, nested dissection", [&] {
    GridSolver solver(pixels, one_thread);
    Eigen::VectorXd x;
    return solver.solve(system, 1e-11 * system.largest_diagonal(), x) == SolveStatus::solved;
  });
}

void height() {
  using namespace height_scenes;
  const Scene scene = render(bumps(64), {64, 64}, nullptr, {0.3, -0.2, -0.8, 0}, 0.002);
  count("height", [&] {
    const LightEstimate light =
        estimate_light(scene.state.i_un, scene.normals, scene.state.valid_pixels(), nullptr, {}, one_thread);
    const HeightInput input{scene.state, scene.reflection, nullptr, light, nullptr};
    return solve_height(input, {}, one_thread).status == HeightStatus::converged;
  });
}

void prior() {
  using namespace cloud_scenes;
  const PointCloud dense = cluttered(true);
  PointCloud sparse;
  add_wave(sparse, 500, 0, 0.3, 0, 1);
  const Pinhole camera = test_camera();
  const Mask everything(camera.size, 1, 255);
  Mask part(camera.size);
  for (int v = 0; v < 39; ++v) std::fill_n(part.row(v), 45, 255);
  count("visible points",
        [&] { return visible_points(dense, camera, {}, everything, {}, one_thread).census.hidden == 1500; });
  count("prior of a cloud",
        [&] { return std::isfinite(project_prior(sparse, camera, {}, part, {}, one_thread).depth(20, 20)); });
}

void sweep() {
  using namespace sweep_scenes;
  const Scene scene = make_scene(bumps, 3);
  count("surface sweep",
        [&] { return sweep_surface(scene.input, scene.views, test_options(), one_thread).completeness > 0.95; });
}

void fusion() {
  // Leave out the parts that take the same time at any size: at this size, they would dominate the tiles' solver.
  RefineOptions options;
  options.search = options.lobe = false;
  for (const Reflection kind : {Reflection::diffuse, Reflection::specular}) {
    SyntheticOptions scene;
    scene.size = {48, 40};
    scene.kind = kind;
    scene.model.environment.radiance.fill(0.1);
    scene.model.mirror = {0.12, 13};
    const SyntheticStation station = make_station(scene);
    count(kind == Reflection::diffuse ? "refinement, diffuse" : "refinement, specular", [&] {
      const FusedSurface surface = refine(station.state, station.prior, {}, options, one_thread).surface;
      return surface.status == FusionStatus::converged;
    });
  }
}

void mesh(const std::filesystem::path& folder) {
  using namespace scenes;
  const Size size{320, 240};
  const Pinhole camera = centerd_camera(size, 1000);
  const FusedSurface surface = surface_of(size, 1000, [&](int u, int v) {
    return sphere_depth(camera, {0, 0, 900}, 400, u, v);
  });
  const Image<float> color(size, 1, 0.3F);
  const Image<std::uint8_t> photograph(size, 1, 128);
  TriangleMesh made;
  count("mesh", [&] {
    made = mesh_from_depth(surface, color, {}, one_thread);
    return made.triangles.size() > 100000;
  });
  count("mesh files", [&] {
    write_ply(folder / "mesh.ply", made);
    write_glb(folder / "mesh.glb", made, {photograph, camera, surface.pose}, length_unit("mm"), "mesh");
    return true;
  });
}

}  // namespace

int main(int arguments, char** argument) {
  if (arguments != 2) {
    std::cerr << "usage: performance_kernels FOLDER\n";
    return 2;
  }
  try {
    sinusoid_fit_and_zenith();
    registration();
    grid_system();
    height();
    prior();
    sweep();
    fusion();
    mesh(argument[1]);
  } catch (const std::exception& error) {
    std::cerr << error.what() << '\n';
    return 1;
  }
}
