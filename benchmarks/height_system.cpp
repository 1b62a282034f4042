// Solves the height-like system of SIDE × SIDE pixels once. Prints a JSON line: seconds from the assembled system to
// the solution, peak memory of the process, |A x − b| / |b|. `export FILE` writes the lower triangle and the right-hand
// side for other solvers: n, entries (int64), column starts, rows (int32), values, right-hand side (double).
#include <sys/resource.h>

#include <Eigen/CholmodSupport>
#include <chrono>
#include <cstdint>
#include <fstream>
#include <iostream>
#include <string>

#include "height_like_system.h"
#include "malus/linalg/grid_solver_internal.h"

using namespace malus;

namespace {

constexpr double relative_ridge = 1e-11;

void export_system(const GridSystem& system, double ridge, const std::string& path) {
  const SymmetricSolver::Matrix lower = system.lower(ridge);
  std::ofstream file(path, std::ios::binary);
  const auto write = [&](const auto* data, Eigen::Index count) {
    file.write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(sizeof(*data)) * count);
  };
  const std::int64_t sizes[] = {lower.cols(), lower.nonZeros()};
  write(sizes, 2);
  write(lower.outerIndexPtr(), lower.cols() + 1);
  write(lower.innerIndexPtr(), lower.nonZeros());
  write(lower.valuePtr(), lower.nonZeros());
  write(system.right().data(), system.right().size());
}

}  // namespace

int main(int count, char** arguments) {
  if (count < 4) {
    std::cerr << "usage: height_system SIDE THREADS cholmod|malus|export [FILE]\n";
    return 2;
  }
  const int side = std::stoi(arguments[1]);
  const std::string solver = arguments[3];
  const Context context{.threads = std::stoi(arguments[2])};
  const PixelIndex pixels(Mask({side, side}, 1, 1));
  GridSystem system(pixels);
  add_height_like_rows(system);
  const double ridge = relative_ridge * system.largest_diagonal();
  if (solver == "export") {
    export_system(system, ridge, arguments[4]);
    std::cout << "{}\n";
    return 0;
  }
  Eigen::VectorXd x;
  const auto start = std::chrono::steady_clock::now();
  if (solver == "cholmod") {
    const SymmetricSolver::Matrix lower = system.lower(ridge);
    // CHOLMOD called directly, as by a user of that library, with its own ordering.
    Eigen::CholmodSupernodalLLT<SymmetricSolver::Matrix, Eigen::Lower> direct;
    // The ordering that CHOLMOD would choose in the end; without this it tries others first.
    direct.cholmod().nmethods = 1;
    direct.cholmod().method[0].ordering = CHOLMOD_METIS;
    direct.compute(lower);
    x = direct.solve(system.right());
  } else {
    GridSolver(pixels, context).solve(system, ridge, x);
  }
  const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
  const SymmetricSolver::Matrix lower = system.lower(ridge);
  const double residual = (lower.selfadjointView<Eigen::Lower>() * x - system.right()).norm() / system.right().norm();
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  std::cout << "{\"seconds\": " << seconds.count() << ", \"gb\": " << static_cast<double>(usage.ru_maxrss) * 1024 / 1e9
            << ", \"residual\": " << residual << "}\n";
}
