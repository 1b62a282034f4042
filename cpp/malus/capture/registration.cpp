#include "malus/capture/registration.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/core.hpp>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgproc.hpp>
#include <sstream>

#include "malus/core/parallel.h"

namespace malus {
namespace {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

constexpr int smallest_side_px = 48;
constexpr int coarsest_side_px = 110;
constexpr int tiles_across = 12, tiles_down = 8;
constexpr double step_limit_px = 4;
constexpr double coarse_tolerance_px = 0.01, fine_tolerance_px = 3e-4;
/// Least share of the gradients' energy that must be texture and not noise.
constexpr double least_texture = 0.1;
/// Least regression of an image's band on the others' that still counts as the same scene.
constexpr double least_similarity = 0.25;

/// OpenCV's thread count is global; borrowed for the time of one registration.
class OpenCvThreads {
 public:
  explicit OpenCvThreads(int threads) : before_(cv::getNumThreads()) {
    // More threads than processors make OpenCV's TBB backend print a warning.
    cv::setNumThreads(std::clamp(threads, 1, std::max(cv::getNumberOfCPUs(), 1)));
  }
  ~OpenCvThreads() { cv::setNumThreads(before_); }
  OpenCvThreads(const OpenCvThreads&) = delete;
  OpenCvThreads& operator=(const OpenCvThreads&) = delete;

 private:
  int before_;
};

cv::Mat as_mat(Image<float>& image) {
  return {image.height(), image.width(), CV_32F, image.data()};
}
cv::Mat as_mat(const Image<float>& image) {
  return {image.height(), image.width(), CV_32F, const_cast<float*>(image.data())};
}

Image<float> half_size(const Image<float>& image) {
  Image<float> half({(image.width() + 1) / 2, (image.height() + 1) / 2});
  cv::Mat out = as_mat(half);
  cv::pyrDown(as_mat(image), out, out.size());
  return half;
}

/// Displacement p(x) = (p0 + p2 x + p3 y, p1 + p4 x + p5 y), x and y from the centre in units of the width.
Affine displaced(const Affine& map, const Vector6& p, Size size) {
  const double w = size.width, cu = 0.5 * (size.width - 1), cv = 0.5 * (size.height - 1);
  Eigen::Matrix2d linear = Eigen::Matrix2d::Identity();
  linear(0, 0) += p[2] / w;
  linear(0, 1) += p[3] / w;
  linear(1, 0) += p[4] / w;
  linear(1, 1) += p[5] / w;
  const Eigen::Vector2d shift(p[0] - (p[2] * cu + p[3] * cv) / w, p[1] - (p[4] * cu + p[5] * cv) / w);
  Affine result;
  result.leftCols<2>() = map.leftCols<2>() * linear;
  result.col(2) = map.leftCols<2>() * shift + map.col(2);
  return result;
}

std::array<Eigen::Vector2d, 5> corners_and_center(Size size) {
  const double right = size.width - 1, bottom = size.height - 1;
  return {{{0, 0}, {right, 0}, {0, bottom}, {right, bottom}, {0.5 * right, 0.5 * bottom}}};
}

/// Mean square of the displacement over corners and centre, for a covariance (or outer product) of the parameters.
double mean_square_displacement(const Matrix6& covariance, Size size) {
  const double w = size.width;
  double sum = 0;
  for (const Eigen::Vector2d& corner : corners_and_center(size)) {
    const double x = (corner.x() - 0.5 * (size.width - 1)) / w, y = (corner.y() - 0.5 * (size.height - 1)) / w;
    Vector6 along_u, along_v;
    along_u << 1, 0, x, y, 0, 0;
    along_v << 0, 1, 0, 0, x, y;
    sum += along_u.dot(covariance * along_u) + along_v.dot(covariance * along_v);
  }
  return sum / 5;
}

struct Region {
  int u0, v0, u1, v1;  ///< half open
  bool empty() const { return u1 <= u0 || v1 <= v0; }
};

/// Pixels whose band is free of border effects in every image.
Region common_region(const std::vector<Affine>& maps, Size size, int margin) {
  double left = 0, top = 0, right = 0, bottom = 0;
  for (const Affine& map : maps) {
    for (const Eigen::Vector2d& corner : corners_and_center(size)) {
      const Eigen::Vector2d moved = map.leftCols<2>() * corner + map.col(2) - corner;
      left = std::max(left, -moved.x());
      top = std::max(top, -moved.y());
      right = std::max(right, moved.x());
      bottom = std::max(bottom, moved.y());
    }
  }
  const auto reach = [&](double outside) { return static_cast<int>(std::min(std::ceil(outside), 1e6)) + margin; };
  return {reach(left), reach(top), size.width - reach(right), size.height - reach(bottom)};
}

/// One level of the pyramid: images of all polarizer positions, and what does not change between iterations.
class Level {
 public:
  Level(const std::vector<const Image<float>*>& images, const NoiseModel& noise, const RegistrationOptions& options,
        const Context& context)
      : images_(images), noise_(noise), options_(options), context_(context), size_(images[0]->size()) {
    margin_ =
        std::min(static_cast<int>(std::lround(1.5 * options.coarse_sigma_px)), std::min(size_.width, size_.height) / 8);
    bands_.resize(images.size());
    bands_[0] = band(*images[0], &inverse_noise_);
  }

  /// Gauss–Newton from the given maps; returns the last step's largest displacement [px].
  double solve(std::vector<Affine>& maps, double tolerance_px) {
    double step_px = 0;
    for (int iteration = 0; iteration < options_.max_iterations; ++iteration) {
      warp(maps);
      step_px = step(maps);
      if (!(step_px > tolerance_px)) break;
    }
    return step_px;
  }

  /// Translation of image k by phase correlation, if it agrees better with the first image than none does.
  Affine phase_correlation(std::size_t k) {
    Affine shifted = identity_affine();
    const Image<float> unmoved = band(*images_[k], nullptr);
    cv::Mat window;
    cv::createHanningWindow(window, {size_.width, size_.height}, CV_32F);
    // Copies: OpenCV 4.6 applies the window to its inputs in place when their size needs no padding.
    const cv::Point2d shift = cv::phaseCorrelate(as_mat(bands_[0]).clone(), as_mat(unmoved).clone(), window);
    shifted.col(2) = Eigen::Vector2d(shift.x, shift.y);
    const double limit = options_.max_shift * size_.width;
    if (!(shifted.col(2).norm() <= limit)) return identity_affine();
    const Image<float> moved = band(warped(*images_[k], shifted), nullptr);
    return correlation(moved, shifted) > correlation(unmoved, shifted) ? shifted : identity_affine();
  }

  /// Uncertainty, texture and similarity at the given maps.
  struct Assessment {
    std::vector<double> rms_px, similarity;
    double texture = 0;
  };
  Assessment assess(const std::vector<Affine>& maps) {
    warp(maps);
    const Normals normals = normal_equations(maps, true);
    Assessment result{std::vector<double>(maps.size()), std::vector<double>(maps.size()), 0};
    result.texture = normals.gradient_energy > 0 ? 1 - normals.noise_energy / normals.gradient_energy : 0;
    const Eigen::LDLT<Matrix6> factor(normals.matrix);
    const Matrix6 inverse = factor.solve(Matrix6::Identity());
    for (std::size_t k = 1; k < maps.size(); ++k) {
      Matrix6 scatter = Matrix6::Zero();
      for (const auto& tile : normals.tile_sides) {
        const Vector6 difference = tile[k] - tile[0];
        scatter += difference * difference.transpose();
      }
      result.rms_px[k] = std::sqrt(mean_square_displacement(inverse * scatter * inverse, size_));
      result.similarity[k] = normals.others_energy[k] > 0 ? normals.products[k] / normals.others_energy[k] : 0;
    }
    return result;
  }

 private:
  struct Normals {
    Matrix6 matrix = Matrix6::Zero();
    std::vector<Vector6> sides;
    std::vector<std::vector<Vector6>> tile_sides;
    double gradient_energy = 0, noise_energy = 0;
    std::vector<double> products, others_energy;

    explicit Normals(std::size_t images)
        : sides(images, Vector6::Zero()), products(images, 0.0), others_energy(images, 0.0) {}
  };

  Image<float> warped(const Image<float>& image, const Affine& map) const {
    Image<float> result =
        resample(image, size_, ResamplingMap(std::nullopt, map), options_.interpolation, context_).image;
    // Outside the source: the nearest pixel, so that the blur has something to work on. These pixels are not compared.
    parallel_rows(context_, size_.height, [&](int v) {
      for (int u = 0; u < size_.width; ++u) {
        if (!std::isnan(result(u, v))) continue;
        const Eigen::Vector2d at = map.leftCols<2>() * Eigen::Vector2d(u, v) + map.col(2);
        result(u, v) = image(static_cast<int>(std::clamp(std::round(at.x()), 0.0, size_.width - 1.0)),
                             static_cast<int>(std::clamp(std::round(at.y()), 0.0, size_.height - 1.0)));
      }
    });
    return result;
  }

  /// (G_fine − G_coarse) I / G_coarse I, and 1 / its expected standard deviation (up to a common factor).
  Image<float> band(const Image<float>& image, Image<float>* inverse_noise) const {
    context_.check_cancel();
    Image<float> fine(size_), coarse(size_);
    cv::Mat fine_mat = as_mat(fine), coarse_mat = as_mat(coarse);
    cv::GaussianBlur(as_mat(image), fine_mat, {}, options_.fine_sigma_px, 0, cv::BORDER_REFLECT_101);
    context_.check_cancel();
    cv::GaussianBlur(as_mat(image), coarse_mat, {}, options_.coarse_sigma_px, 0, cv::BORDER_REFLECT_101);
    const auto floor = static_cast<float>(std::max(3 * std::sqrt(noise_.variance(0)), 1e-6));
    const double blur_gain = 1 / (4 * std::numbers::pi * options_.fine_sigma_px * options_.fine_sigma_px);
    if (inverse_noise) *inverse_noise = Image<float>(size_);
    for (std::size_t i = 0; i < fine.count(); ++i) {
      const float mean = std::max(coarse[i], floor);
      fine[i] = (fine[i] - coarse[i]) / mean;
      if (inverse_noise) {
        (*inverse_noise)[i] = static_cast<float>(mean / std::sqrt(std::max(blur_gain * noise_.variance(mean), 1e-14)));
      }
    }
    return fine;
  }

  void warp(const std::vector<Affine>& maps) {
    for (std::size_t k = 1; k < maps.size(); ++k) bands_[k] = band(warped(*images_[k], maps[k]), nullptr);
    mean_ = Image<float>(size_);
    parallel_rows(context_, size_.height, [&](int v) {
      for (const Image<float>& one : bands_) {
        for (int u = 0; u < size_.width; ++u) mean_(u, v) += one(u, v) / static_cast<float>(bands_.size());
      }
    });
  }

  double correlation(const Image<float>& moved, const Affine& map) const {
    const Region region = common_region({map}, size_, margin_);
    double ab = 0, bb = 0;
    for (int v = region.v0; v < region.v1; ++v) {
      for (int u = region.u0; u < region.u1; ++u) {
        const double n2 = inverse_noise_(u, v) * inverse_noise_(u, v);
        ab += n2 * bands_[0](u, v) * moved(u, v);
        bb += n2 * moved(u, v) * moved(u, v);
      }
    }
    return bb > 0 ? ab / std::sqrt(bb) : 0;
  }

  /// Disagreement of the images at a pixel, per degree of freedom, in units of the expected noise variance.
  double disagreement(int u, int v) const {
    double sum = 0;
    for (const Image<float>& one : bands_) {
      const double residual = one(u, v) - mean_(u, v);
      sum += residual * residual;
    }
    const double n = inverse_noise_(u, v);
    return n * n * sum / static_cast<double>(bands_.size() - 1);
  }

  /// Lower quartile of the disagreement: that of pixels whose contrast the polarizer hardly changes.
  double disagreement_scale(const Region& region) const {
    const int stride = std::max(1, static_cast<int>(std::sqrt(static_cast<double>(size_.area()) / 2e5)));
    std::vector<double> values;
    for (int v = region.v0; v < region.v1; v += stride) {
      for (int u = region.u0; u < region.u1; u += stride) values.push_back(disagreement(u, v));
    }
    const auto quartile = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 4);
    std::nth_element(values.begin(), quartile, values.end());
    return std::max(*quartile, 1e-4);
  }

  Normals normal_equations(const std::vector<Affine>& maps, bool assess) const {
    const std::size_t count = bands_.size();
    const Region region = common_region(maps, size_, margin_);
    Normals total(count);
    if (region.empty()) return total;
    const double cauchy = disagreement_scale(region) * options_.cauchy_scale * options_.cauchy_scale;
    std::vector<Normals> tiles(tiles_across * tiles_down, Normals(count));
    parallel_for(context_, tiles.size(), 1, [&](std::size_t begin, std::size_t) {
      const int column = static_cast<int>(begin) % tiles_across, row = static_cast<int>(begin) / tiles_across;
      const auto part = [](int from, int to, int index, int parts) {
        return from + static_cast<int>(static_cast<long>(to - from) * index / parts);
      };
      const Region tile{part(region.u0, region.u1, column, tiles_across), part(region.v0, region.v1, row, tiles_down),
                        part(region.u0, region.u1, column + 1, tiles_across),
                        part(region.v0, region.v1, row + 1, tiles_down)};
      add_tile(tile, cauchy, assess, tiles[begin]);
    });
    for (Normals& tile : tiles) {
      total.matrix += tile.matrix;
      total.gradient_energy += tile.gradient_energy;
      total.noise_energy += tile.noise_energy;
      for (std::size_t k = 0; k < count; ++k) {
        total.sides[k] += tile.sides[k];
        total.products[k] += tile.products[k];
        total.others_energy[k] += tile.others_energy[k];
      }
      total.tile_sides.push_back(std::move(tile.sides));
    }
    return total;
  }

  void add_tile(const Region& tile, double cauchy, bool assess, Normals& sum) const {
    const double width = size_.width;
    for (int v = tile.v0; v < tile.v1; ++v) {
      const double y = (v - 0.5 * (size_.height - 1)) / width;
      for (int u = tile.u0; u < tile.u1; ++u) {
        const double n = inverse_noise_(u, v), x = (u - 0.5 * (size_.width - 1)) / width;
        const double weight = n * n / (1 + disagreement(u, v) / cauchy);
        const double gu = 0.5 * (mean_(u + 1, v) - mean_(u - 1, v)), gv = 0.5 * (mean_(u, v + 1) - mean_(u, v - 1));
        Vector6 gradient;
        gradient << gu, gv, gu * x, gu * y, gv * x, gv * y;
        const Vector6 weighted = weight * gradient;
        sum.matrix.noalias() += weighted * gradient.transpose();
        for (std::size_t k = 0; k < bands_.size(); ++k) {
          sum.sides[k] += (mean_(u, v) - static_cast<double>(bands_[k](u, v))) * weighted;
        }
        if (assess) add_assessment(u, v, weight, gu * gu + gv * gv, sum);
      }
    }
  }

  /// Gradient energy of the mean image, the part of it that the images' disagreement accounts for, and each image's
  /// regression on the others.
  void add_assessment(int u, int v, double weight, double energy, Normals& sum) const {
    const auto count = static_cast<double>(bands_.size());
    double noise = 0;
    for (std::size_t k = 0; k < bands_.size(); ++k) {
      const auto residual = [&](int i, int j) { return static_cast<double>(bands_[k](i, j)) - mean_(i, j); };
      const double ru = 0.5 * (residual(u + 1, v) - residual(u - 1, v));
      const double rv = 0.5 * (residual(u, v + 1) - residual(u, v - 1));
      noise += ru * ru + rv * rv;
      const double others = (count * mean_(u, v) - bands_[k](u, v)) / (count - 1);
      sum.products[k] += weight * others * bands_[k](u, v);
      sum.others_energy[k] += weight * others * others;
    }
    sum.gradient_energy += weight * energy;
    sum.noise_energy += weight * noise / (count * (count - 1));
  }

  double step(std::vector<Affine>& maps) {
    const Normals normals = normal_equations(maps, false);
    const Eigen::LDLT<Matrix6> factor(normals.matrix);
    double largest = 0;
    if (factor.info() != Eigen::Success || !factor.isPositive()) return 0;
    for (std::size_t k = 1; k < maps.size(); ++k) {
      Vector6 p = factor.solve(normals.sides[k] - normals.sides[0]);
      if (!p.allFinite()) return 0;
      const double length = std::sqrt(mean_square_displacement(p * p.transpose(), size_));
      if (length > step_limit_px) p *= step_limit_px / length;
      maps[k] = displaced(maps[k], p, size_);
      largest = std::max(largest, length);
    }
    return largest;
  }

  std::vector<const Image<float>*> images_;
  const NoiseModel& noise_;
  const RegistrationOptions& options_;
  const Context& context_;
  Size size_;
  int margin_ = 0;
  Image<float> inverse_noise_;       // of one band, from the first image
  std::vector<Image<float>> bands_;  // aligned to the first
  Image<float> mean_;
};

/// Half-size images, coarser and coarser; level 0 is the input itself.
using Pyramid = std::vector<std::vector<Image<float>>>;

Pyramid coarser_levels(const std::vector<Image<float>>& images) {
  Pyramid pyramid;
  const std::vector<Image<float>>* finer = &images;
  while (std::min((*finer)[0].width(), (*finer)[0].height()) >= 2 * coarsest_side_px) {
    std::vector<Image<float>> halves;
    for (const Image<float>& image : *finer) halves.push_back(half_size(image));
    pyramid.push_back(std::move(halves));
    finer = &pyramid.back();
  }
  return pyramid;
}

std::vector<const Image<float>*> pointers_to(const std::vector<Image<float>>& images) {
  std::vector<const Image<float>*> pointers;
  for (const Image<float>& image : images) pointers.push_back(&image);
  return pointers;
}

/// Why a displacement cannot be believed, or nothing.
void judge(ImageRegistration& result, double similarity, double texture, double last_step_px, Size size,
           const RegistrationOptions& options) {
  std::ostringstream message;
  message.precision(3);
  const double linear = (result.image_from_base.leftCols<2>() - Eigen::Matrix2d::Identity()).norm();
  if (!(texture >= least_texture) || !(result.rms_px <= options.max_uncertainty_px)) {
    result.status = RegistrationStatus::no_texture;
    message << "too little texture: " << 100 * std::max(texture, 0.0)
            << " % of the contrast is not noise, displacement known to " << result.rms_px << " px";
  } else if (!(result.displacement_px <= options.max_shift * size.width) || !(linear <= options.max_shift)) {
    result.status = RegistrationStatus::implausible;
    message << "displacement of " << result.displacement_px << " px, more than " << 100 * options.max_shift
            << " % of the image width";
  } else if (!(similarity >= least_similarity)) {
    result.status = RegistrationStatus::implausible;
    message << "the image does not resemble the others (regression " << similarity << ")";
  } else if (!(last_step_px <= 0.01)) {
    result.status = RegistrationStatus::not_converged;
    message << "still moving by " << last_step_px << " px after " << options.max_iterations << " iterations";
  } else {
    result.status = RegistrationStatus::ok;
  }
  result.message = message.str();
  if (result.status != RegistrationStatus::ok) result.image_from_base = identity_affine();
}

}  // namespace

double affine_distance_px(const Affine& a, const Affine& b, Size size) {
  double sum = 0;
  for (const Eigen::Vector2d& corner : corners_and_center(size)) {
    sum += ((a - b).leftCols<2>() * corner + (a - b).col(2)).squaredNorm();
  }
  return std::sqrt(sum / 5);
}

std::vector<ImageRegistration> register_images(const std::vector<Image<float>>& images, const NoiseModel& noise,
                                               const RegistrationOptions& options, const Context& context) {
  validate_fields(options, "capture");
  std::vector<ImageRegistration> results(images.size());
  if (images.empty()) return results;
  const Size size = images[0].size();
  for (std::size_t k = 0; k < images.size(); ++k) require_size(images[k], size, "image " + std::to_string(k));
  results[0].status = RegistrationStatus::ok;
  if (images.size() == 1) return results;
  if (std::min(size.width, size.height) < smallest_side_px) {
    for (std::size_t k = 1; k < images.size(); ++k) {
      results[k].status = RegistrationStatus::no_texture;
      results[k].message = "the image is " + to_string(size) + " pixels, too small to register";
    }
    return results;
  }

  const OpenCvThreads opencv_threads(context.threads);
  Pyramid pyramid = coarser_levels(images);
  const auto levels = static_cast<double>(pyramid.size() + 1);
  std::vector<Affine> maps(images.size(), identity_affine());
  Level::Assessment assessment;
  double last_step_px = 0;
  for (bool first = true;; first = false) {
    const bool finest = pyramid.empty();
    context.progress("capture", (levels - static_cast<double>(pyramid.size()) - 1) / levels, "registration");
    Level level(finest ? pointers_to(images) : pointers_to(pyramid.back()), noise, options, context);
    for (std::size_t k = 1; first && k < images.size(); ++k) maps[k] = level.phase_correlation(k);
    last_step_px = level.solve(maps, finest ? fine_tolerance_px : coarse_tolerance_px);
    if (finest) {
      assessment = level.assess(maps);
      break;
    }
    for (Affine& map : maps) map.col(2) *= 2;
    pyramid.pop_back();
  }
  for (std::size_t k = 1; k < images.size(); ++k) {
    results[k].image_from_base = maps[k];
    results[k].displacement_px = affine_distance_px(maps[k], identity_affine(), size);
    results[k].rms_px = assessment.rms_px[k];
    judge(results[k], assessment.similarity[k], assessment.texture, last_step_px, size, options);
  }
  return results;
}

}  // namespace malus
