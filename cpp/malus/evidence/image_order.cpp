#include <algorithm>
#include <cmath>
#include <iomanip>
#include <limits>
#include <numeric>
#include <sstream>

#include "malus/core/degrees_internal.h"
#include "malus/evidence/image_order_internal.h"
#include "malus/evidence/pixel_samples_internal.h"
#include "malus/polarization/polarizer_fit_internal.h"

namespace malus {
namespace {

using Order = std::vector<Eigen::Index>;

constexpr std::size_t min_samples = 200, most_permuted = 8;
/// Of 82 rendered stations in the right order none exceeds 1.3; of 82 with two images exchanged 75 exceed
/// `clear_ratio`.
constexpr double clear_ratio = 4;
/// Squared residuals over the least ones up to which an order fits about as well.
constexpr double about_as_well = 1.2;

std::size_t moved(const Order& order) {
  std::size_t count = 0;
  for (std::size_t k = 0; k < order.size(); ++k) count += order[k] != static_cast<Eigen::Index>(k);
  return count;
}

/// Σ I Iᵀ / mean I over the samples.
Eigen::MatrixXd products_of(const PixelSamples& samples, const Context& context) {
  const Eigen::Index count = samples.values.front().size();
  Eigen::MatrixXd products = Eigen::MatrixXd::Zero(count, count);
  for (std::size_t i = 0; i < samples.values.size(); ++i) {
    if (i % PixelSamples::between_checks == 0) context.check_cancel();
    const Eigen::VectorXd& values = samples.values[i];
    products += values * values.transpose() / values.mean();
  }
  return products;
}

/// Σ squared residuals if image k has angle number order[k].
double misfit_of(const Order& order, const Eigen::MatrixXd& projection, const Eigen::MatrixXd& products) {
  return std::max(projection(order, order).cwiseProduct(products).sum(), 0.0);
}

/// The least misfit of all orders that are tried, and the orders among which the best is found; the given one is first.
struct TriedOrders {
  struct Tried {
    Order order;
    double misfit;
  };
  std::vector<Tried> orders;
  double least;
};

TriedOrders all_orders(const Eigen::MatrixXd& projection, const Eigen::MatrixXd& products, const Context& context) {
  Order order(static_cast<std::size_t>(products.rows()));
  std::iota(order.begin(), order.end(), 0);
  TriedOrders tried{{}, std::numeric_limits<double>::infinity()};
  do {
    context.check_cancel();
    tried.orders.push_back({order, misfit_of(order, projection, products)});
    tried.least = std::min(tried.least, tried.orders.back().misfit);
  } while (std::ranges::next_permutation(order).found);
  return tried;
}

/// Exchanges of two images. Of hundreds of images there are so many that only those that may be the best are kept, and
/// that a misfit is computed from the given order's.
TriedOrders exchanges(const Eigen::MatrixXd& projection, const Eigen::MatrixXd& products, const Context& context) {
  const Eigen::Index count = products.rows();
  Order given(static_cast<std::size_t>(count));
  std::iota(given.begin(), given.end(), 0);
  const double as_given = misfit_of(given, projection, products);
  TriedOrders tried{{}, as_given};
  tried.orders.push_back({given, as_given});
  for (Eigen::Index i = 0; i < count; ++i) {
    context.check_cancel();
    for (Eigen::Index j = i + 1; j < count; ++j) {
      const Eigen::VectorXd a = projection.col(j) - projection.col(i), b = products.col(i) - products.col(j);
      const double change = 2 * (a.dot(b) - a[i] * b[i] - a[j] * b[j]) +
                            (projection(j, j) - projection(i, i)) * (products(i, i) - products(j, j));
      const double misfit = std::max(as_given + change, 0.0);
      const bool may_be_best = misfit <= about_as_well * std::min(tried.least, as_given / clear_ratio);
      tried.least = std::min(tried.least, misfit);
      if (!may_be_best) continue;
      tried.orders.push_back({given, misfit});
      std::swap(tried.orders.back().order[static_cast<std::size_t>(i)],
                tried.orders.back().order[static_cast<std::size_t>(j)]);
    }
  }
  return tried;
}

std::string in_degrees(const std::vector<double>& angles_rad) {
  std::ostringstream text;
  text << '[';
  for (std::size_t k = 0; k < angles_rad.size(); ++k)
    text << (k > 0 ? ", " : "") << std::round(to_degrees(10 * angles_rad[k])) / 10;
  text << ']';
  return text.str();
}

}  // namespace

ImageOrder check_image_order(const std::vector<Image<float>>& images, const std::vector<double>& angles_rad,
                             const Mask& mask, const Context& context) {
  ImageOrder result;
  result.angles_rad = angles_rad;
  Finding& finding = result.finding;
  finding.check = Check::order;
  // Images shifted by a fraction of a pixel differ where brightness changes from pixel to pixel, which in some order
  // looks like polarization. Means over several pixels suppress this; polarization hardly changes over them.
  constexpr int reach_px = 2;
  const PixelSamples samples = pixel_samples(images, angles_rad, mask, reach_px, context);
  if (images.size() < 4 || samples.values.size() < min_samples) {
    finding.message =
        "whether the images are in the order of their angles could not be checked: expected four images "
        "or more, and an object of some hundred pixels that are neither dark nor saturated";
    return result;
  }
  const Eigen::MatrixXd products = products_of(samples, context),
                        projection = residual_projection(polarizer_rows(angles_rad));
  const TriedOrders tried = images.size() <= most_permuted ? all_orders(projection, products, context)
                                                           : exchanges(projection, products, context);
  // Of orders that fit about as well, choose the one that moves the fewest images.
  const double as_given = tried.orders.front().misfit, least = std::max(tried.least, 1e-12 * products.trace());
  std::size_t best = 0;
  if (as_given > clear_ratio * least) {
    std::size_t fewest = images.size() + 1;
    for (std::size_t i = 0; i < tried.orders.size(); ++i) {
      const auto& [order, misfit] = tried.orders[i];
      if (misfit > about_as_well * least || moved(order) >= fewest) continue;
      fewest = moved(order);
      best = i;
    }
  }
  result.misfit_ratio = as_given / least;
  finding.figures = {{"misfit_ratio", result.misfit_ratio}};
  if (best == 0) {
    finding.message = "the images are in the order of their angles, as far as the sinusoid tells";
    return result;
  }
  for (std::size_t k = 0; k < images.size(); ++k)
    result.angles_rad[k] = angles_rad[static_cast<std::size_t>(tried.orders[best].order[k])];
  std::ostringstream text;
  text << std::fixed << std::setprecision(result.misfit_ratio < 10 ? 1 : 0);
  text << "the images do not seem to be in the order of their angles: in another order the squared misfit of the "
          "sinusoid is "
       << result.misfit_ratio << " times smaller";
  finding.severity = Severity::warning;
  finding.message = text.str();
  finding.suggestion =
      "for the images as they are, angles such as " + in_degrees(result.angles_rad) + "° (counter-clockwise) fit";
  return result;
}

}  // namespace malus
