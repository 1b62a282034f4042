#include <algorithm>
#include <cstddef>
#include <sstream>

#include "malus/core/degrees_internal.h"
#include "malus/polarization/pixel_curves_internal.h"

namespace malus {
namespace {

/// Index of a pixel at each of a few ranks of the degree.
std::vector<std::size_t> pixels_at_ranks(const PolarizationState& state) {
  constexpr double ranks[] = {0.1, 0.5, 0.9, 0.99};
  constexpr std::size_t most_candidates = 100'000, fewest_candidates = 2'000;
  const auto is_valid = [](std::uint8_t pixel) { return has_state(pixel, PixelState::valid); };
  std::vector<std::size_t> valid;
  // Of a small object in a large image, the image's stride would meet few pixels or none.
  const auto all = static_cast<std::size_t>(std::count_if(state.valid.begin(), state.valid.end(), is_valid));
  const std::size_t of_image = state.valid.count() / most_candidates + 1;
  const std::size_t stride = std::clamp<std::size_t>(all / fewest_candidates, 1, of_image);
  for (std::size_t i = 0; i < state.valid.count(); i += stride)
    if (is_valid(state.valid[i])) valid.push_back(i);
  std::sort(valid.begin(), valid.end(), [&](std::size_t a, std::size_t b) { return state.rho[a] < state.rho[b]; });
  std::vector<std::size_t> chosen;
  if (valid.empty()) return chosen;
  for (const double rank : ranks)
    chosen.push_back(valid[static_cast<std::size_t>(rank * static_cast<double>(valid.size() - 1))]);
  return chosen;
}

std::size_t index_of(const std::array<double, 2>& pixel, Size size) {
  const auto& [u, v] = pixel;
  if (u >= 0 && v >= 0 && u < size.width && v < size.height)
    return size.index(static_cast<int>(u), static_cast<int>(v));
  std::ostringstream message;
  message << "[polarized].curve_pixels has [" << u << ", " << v << "], expected pixels within the polarized image of "
          << to_string(size) << " pixels";
  throw input_error(message.str());
}

}  // namespace

std::vector<PixelCurve> pixel_curves(const PolarizationState& state, const std::vector<Image<float>>& images,
                                     const std::vector<double>& angles_rad,
                                     const std::vector<std::array<double, 2>>& pixels) {
  const auto width = static_cast<std::size_t>(state.size().width);
  std::vector<std::size_t> shown;
  for (const auto& pixel : pixels) shown.push_back(index_of(pixel, state.size()));
  if (pixels.empty()) shown = pixels_at_ranks(state);
  std::vector<PixelCurve> curves;
  for (const std::size_t pixel : shown) {
    PixelCurve curve{static_cast<int>(pixel % width), static_cast<int>(pixel / width), {}, {}};
    for (std::size_t k = 0; k < images.size(); ++k) {
      curve.angles_deg.push_back(to_degrees(angles_rad[k]));
      curve.intensities.push_back(images[k][pixel]);
    }
    curves.push_back(std::move(curve));
  }
  return curves;
}

}  // namespace malus
