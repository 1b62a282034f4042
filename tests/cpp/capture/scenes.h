#pragma once

#include <Eigen/LU>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string>
#include <vector>

#include "malus/capture/capture_internal.h"
#include "malus/capture/response_internal.h"
#include "shared_data.h"

namespace malus {

inline Context two_threads() {
  return {.threads = 2};
}

/// The response that a text states.
inline Response stated(const std::string& text) {
  return Response::of(text).value();
}

/// The curve of this response.
inline ResponseCurve curve_of(const std::string& text) {
  return response_curve(stated(text), "response");
}

/// Input of a rendered station, with the values of its station file.
inline CaptureInput rendered_station(const std::string& scene, const std::string& set, int frames) {
  const auto folder = shared_data() / "rendered" / scene;
  PolarizedSpec spec;
  spec.angles_deg = std::vector<double>{0, 30, 60, 90, 120, 150};
  const bool jpeg = set == "jpeg8";
  if (jpeg) {
    spec.response = stated("srgb");
  } else {
    spec.white_level = 16383;
  }
  spec.frames_averaged = frames;
  spec.full_well_e = 20000;
  spec.read_noise_e = 8;
  for (const std::string angle : {"000", "030", "060", "090", "120", "150"}) {
    spec.images.push_back(folder / "pol" / set / ("pol_" + angle + (jpeg ? ".jpg" : ".png")));
  }
  if (std::filesystem::exists(folder / "mask.png")) spec.mask = folder / "mask.png";
  return capture_input(spec, std::nullopt);
}

/// By how much cubic convolution with a = −0.75 displaces what it interpolates at a fraction of a pixel.
inline double displacement_by_cubic(double position) {
  const auto near = [](double x) { return ((1.25 * x - 2.25) * x) * x + 1; };
  const auto far = [](double x) { return ((-0.75 * x + 3.75) * x - 6) * x + 3; };
  const double f = position - std::floor(position);
  return -far(1 + f) + near(1 - f) + 2 * far(2 - f) - f;
}

/// The map that a station's file states, and what the renderer made of it: it moved images by cubic convolution.
inline Affine map_of_renderer(const Affine& stated, Size size) {
  const Eigen::Matrix2d inverse = stated.leftCols<2>().inverse();
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Matrix<double, 3, 2> sides = Eigen::Matrix<double, 3, 2>::Zero();
  for (int v = 0; v < size.height; v += 5) {
    for (int u = 0; u < size.width; u += 5) {
      const Eigen::Vector2d at = inverse * (Eigen::Vector2d(u, v) - stated.col(2));
      const Eigen::Vector3d shown(at.x() + displacement_by_cubic(at.x()), at.y() + displacement_by_cubic(at.y()), 1);
      normal += shown * shown.transpose();
      sides += shown * Eigen::RowVector2d(u, v);
    }
  }
  const Eigen::Matrix<double, 3, 2> solution = normal.inverse() * sides;
  return solution.transpose();
}

/// The true maps from the first image into the others.
inline std::vector<Affine> true_maps(const std::string& scene, const std::string& set) {
  std::ifstream file(shared_data() / "rendered" / scene / "meta.json");
  const nlohmann::json meta = nlohmann::json::parse(file);
  const Size size{meta["size"][0].get<int>(), meta["size"][1].get<int>()};
  std::vector<Affine> maps;
  for (const auto& matrix : meta["pol_sets"][set]["M_ref_to_image"]) {
    Affine map;
    for (int row = 0; row < 2; ++row) {
      for (int column = 0; column < 3; ++column) {
        map(row, column) = matrix[static_cast<std::size_t>(row)][static_cast<std::size_t>(column)].get<double>();
      }
    }
    maps.push_back(map_of_renderer(map, size));
  }
  return maps;
}

/// A textured scene that can be evaluated anywhere: sums of sines with wavelengths from 7 to 60 px, and the
/// polarization of a slowly varying surface. Intensity in (0, 1).
struct AnalyticScene {
  double polarization = 0.1;

  double intensity(double u, double v, double angle_rad) const {
    double texture = 0;
    for (int i = 0; i < 24; ++i) {
      const double wavelength = 7 + 2.3 * i, direction = 2.4 * i, k = 2 * std::numbers::pi / wavelength;
      texture += 0.03 * std::sin(k * (u * std::cos(direction) + v * std::sin(direction)) + 1.7 * i * i);
    }
    const double phase = 0.01 * u + 0.02 * v, degree = polarization * (0.5 + 0.5 * std::sin(0.03 * u));
    return (0.4 + texture) * (1 + degree * std::cos(2 * (angle_rad - phase)));
  }

  /// The scene moved by `map`: pixel map(x) of the image shows pixel x of the scene.
  Image<float> image(Size size, const Affine& map, double angle_rad) const {
    Image<float> result(size);
    const Eigen::Matrix2d inverse = map.leftCols<2>().inverse();
    for (int v = 0; v < size.height; ++v) {
      for (int u = 0; u < size.width; ++u) {
        const Eigen::Vector2d at = inverse * (Eigen::Vector2d(u, v) - map.col(2));
        result(u, v) = static_cast<float>(intensity(at.x(), at.y(), angle_rad));
      }
    }
    return result;
  }
};

/// Rotation about the image center, scale and shift.
inline Affine similarity(Size size, double turn_rad, double scale, double shift_u, double shift_v) {
  Affine map;
  map.leftCols<2>() << scale * std::cos(turn_rad), -scale * std::sin(turn_rad), scale * std::sin(turn_rad),
      scale * std::cos(turn_rad);
  const Eigen::Vector2d center(0.5 * (size.width - 1), 0.5 * (size.height - 1));
  map.col(2) = center + Eigen::Vector2d(shift_u, shift_v) - map.leftCols<2>() * center;
  return map;
}

/// Input from images in memory, DN = intensity (floating-point file).
inline CaptureInput input_of(std::vector<Image<float>> images, std::vector<double> angles_deg) {
  CaptureInput input;
  input.polarized.angles_deg = std::move(angles_deg);
  input.polarized.full_well_e = 20000;
  input.polarized.read_noise_e = 8;
  for (std::size_t k = 0; k < images.size(); ++k) input.names.push_back("image " + std::to_string(k) + ".tif");
  input.load = [images = std::move(images)](std::size_t k) { return RawImage{images[k], 32}; };
  return input;
}

}  // namespace malus
