#include "malus/assess/high_pass.h"

#include <cmath>
#include <vector>

#include "malus/core/parallel.h"

namespace malus {
namespace {

/// Weights of the offsets 0 … radius; one side of the Gaussian.
std::vector<float> half_kernel(double sigma_px) {
  std::vector<float> kernel(static_cast<std::size_t>(4 * sigma_px + 0.5) + 1);
  for (std::size_t i = 0; i < kernel.size(); ++i) {
    kernel[i] = static_cast<float>(std::exp(-0.5 * std::pow(static_cast<double>(i) / sigma_px, 2)));
  }
  return kernel;
}

/// Index of a position beyond an end, mirrored about the outer edge of the last pixel (… 1 0 | 0 1 …).
int mirrored(int index, int size) {
  const int wrapped = ((index % (2 * size)) + 2 * size) % (2 * size);
  return wrapped < size ? wrapped : 2 * size - 1 - wrapped;
}

/// Filters along rows and writes the result transposed, so that two calls filter both axes.
Image<float> blur_rows_transposed(const Image<float>& image, const std::vector<float>& kernel, const Context& context) {
  const int width = image.width(), radius = static_cast<int>(kernel.size()) - 1;
  Image<float> result({image.height(), width});
  parallel_for(context, static_cast<std::size_t>(image.height()), 16, [&](std::size_t begin, std::size_t end) {
    std::vector<float> padded(static_cast<std::size_t>(width + 2 * radius)), sum(static_cast<std::size_t>(width));
    for (int v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
      for (int i = 0; i < width + 2 * radius; ++i)
        padded[static_cast<std::size_t>(i)] = image(mirrored(i - radius, width), v);
      const float* centre = padded.data() + radius;
      for (int u = 0; u < width; ++u) sum[static_cast<std::size_t>(u)] = kernel[0] * centre[u];
      for (int k = 1; k <= radius; ++k) {
        const float weight = kernel[static_cast<std::size_t>(k)];
        for (int u = 0; u < width; ++u) sum[static_cast<std::size_t>(u)] += weight * (centre[u - k] + centre[u + k]);
      }
      for (int u = 0; u < width; ++u) result(v, u) = sum[static_cast<std::size_t>(u)];
    }
  });
  return result;
}

}  // namespace

Image<float> high_pass(const Image<float>& values, double sigma_px, const Context& context) {
  // Any constant cancels; taking the mean away first keeps the digits of float sums.
  double sum = 0, count = 0;
  for (const float value : values) {
    if (std::isfinite(value)) sum += value, ++count;
  }
  const float mean = count > 0 ? static_cast<float>(sum / count) : 0;
  Image<float> weights(values.size()), filled(values.size());
  for (std::size_t i = 0; i < values.count(); ++i) {
    const bool is_known = std::isfinite(values[i]);
    weights[i] = is_known ? 1 : 0;
    filled[i] = is_known ? values[i] - mean : 0;
  }
  const std::vector<float> kernel = half_kernel(sigma_px);
  const auto blur = [&](const Image<float>& image) {
    return blur_rows_transposed(blur_rows_transposed(image, kernel, context), kernel, context);
  };
  filled = blur(filled);
  weights = blur(weights);
  Image<float> result(values.size());
  for (std::size_t i = 0; i < values.count(); ++i) result[i] = (values[i] - mean) - filled[i] / weights[i];
  return result;
}

}  // namespace malus
