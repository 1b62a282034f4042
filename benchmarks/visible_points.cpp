// Measures visible_points on a dense cloud. Prints a JSON line: seconds, processor seconds of all threads (valid on an
// otherwise idle machine), peak memory of the process, numbers of visible, hidden and outlying points.
//   visible_points MILLION_POINTS WIDTH HEIGHT THREADS
// The cloud is a wavy surface sampled at random pixels, with noise of 1 GSD, a hidden wall and stray points.
#include <sys/resource.h>

#include <chrono>
#include <cmath>
#include <iostream>
#include <random>
#include <string>

#include "malus/prior/visible_points_internal.h"

using namespace malus;

namespace {

constexpr double distance = 400;

double processor_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

PointCloud make_cloud(std::size_t count, const Pinhole& camera) {
  std::mt19937_64 generator(1);
  std::uniform_real_distribution<double> share(0, 1);
  std::normal_distribution<double> noise(0, 1);
  const double gsd = distance / camera.focal();
  PointCloud cloud;
  cloud.points.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    const double u = share(generator) * camera.size.width - 0.5, v = share(generator) * camera.size.height - 0.5;
    double height = 40 * std::sin(u / 60) * std::cos(v / 80) + noise(generator);
    // A wall behind a tenth of the surface, and one stray point in a thousand.
    if (u < 0.1 * camera.size.width && share(generator) < 0.3) height += 300;
    if (share(generator) < 0.001) height -= 100 * share(generator);
    cloud.points.push_back((distance + gsd * height) * camera.ray(u, v));
  }
  return cloud;
}

}  // namespace

int main(int count, char** arguments) {
  if (count != 5) {
    std::cerr << "usage: visible_points MILLION_POINTS WIDTH HEIGHT THREADS\n";
    return 2;
  }
  const Size size{std::stoi(arguments[2]), std::stoi(arguments[3])};
  const Pinhole camera{size, 2.0 * size.width, 2.0 * size.width, 0.5 * size.width, 0.5 * size.height};
  const PointCloud cloud = make_cloud(static_cast<std::size_t>(1e6 * std::stod(arguments[1])), camera);
  const Context context{.threads = std::stoi(arguments[4])};
  const double processor_start = processor_seconds();
  const auto start = std::chrono::steady_clock::now();
  const VisiblePoints visible = visible_points(cloud, camera, {}, Mask(size, 1, 255), {}, context);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  const double processor = processor_seconds() - processor_start;
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  std::cout << "{\"seconds\": " << seconds << ", \"processor_seconds\": " << processor
            << ", \"gb\": " << static_cast<double>(usage.ru_maxrss) * 1024 / 1e9
            << ", \"points\": " << visible.points.size() << ", \"hidden\": " << visible.census.hidden
            << ", \"outliers\": " << visible.census.outliers << ", \"spacing_px\": " << visible.spacing_px << "}\n";
}
