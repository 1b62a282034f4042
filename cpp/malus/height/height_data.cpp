#include <algorithm>
#include <cmath>

#include "malus/core/parallel_internal.h"
#include "malus/height/height_data_internal.h"
#include "malus/polarization/fresnel.h"

namespace malus {
namespace {

HeightData empty_data(Size size, double refractive_index, bool perspective) {
  HeightData data;
  data.perspective = perspective;
  data.refractive_index = refractive_index;
  data.object = Mask(size);
  data.pixels = Image<HeightPixel>(size);
  return data;
}

/// Mean of the finite heights among four, converted to pixels twice as large.
class HeightMean {
 public:
  void add(float height) {
    if (!std::isfinite(height)) return;
    sum_ += height;
    ++count_;
  }
  float value() const { return count_ == 0 ? no_value : static_cast<float>(0.5 * sum_ / count_); }

 private:
  double sum_ = 0;
  int count_ = 0;
};

/// Makes a coarse pixel from up to four fine pixels, the first at (column, row).
void coarsen_pixel(const HeightData& fine, int column, int row, HeightData& coarse, int to_column, int to_row) {
  HeightPixel mean;
  int object = 0, count = 0, specular = 0, above = 0;
  HeightMean prior, border;
  for (int v = row; v < std::min(row + 2, fine.size().height); ++v) {
    for (int u = column; u < std::min(column + 2, fine.size().width); ++u) {
      if (fine.object(u, v) == 0) continue;
      const HeightPixel& pixel = fine.pixels(u, v);
      ++object;
      prior.add(pixel.prior_height);
      border.add(pixel.border_height);
      if (!pixel.has_data()) continue;
      ++count;
      specular += pixel.kind == Reflection::specular;
      above += pixel.branch == SpecularBranch::above_brewster;
      mean.i_un += pixel.i_un;
      mean.s1 += pixel.s1;
      mean.s2 += pixel.s2;
      mean.variance_i += pixel.variance_i;
      mean.variance_s += pixel.variance_s;
    }
  }
  if (object == 0) return;
  coarse.object(to_column, to_row) = 255;
  mean.prior_height = prior.value();
  mean.border_height = border.value();
  if (count > 0) {
    mean.kind = 2 * specular > count ? Reflection::specular : Reflection::diffuse;
    mean.branch = 2 * above > count ? SpecularBranch::above_brewster : SpecularBranch::below_brewster;
    const double degree = std::min(std::hypot(mean.s1, mean.s2) / (2.0 * mean.i_un), 1.0);
    mean.zenith = static_cast<float>(zenith_of(mean.kind, degree, fine.refractive_index, mean.branch).zenith_rad);
    const float share = 1.0F / static_cast<float>(count);
    mean.i_un *= share;
    mean.s1 *= share;
    mean.s2 *= share;
    mean.variance_i *= share * share;
    mean.variance_s *= share * share;
  }
  coarse.pixels(to_column, to_row) = mean;
}

}  // namespace

HeightData height_data(const HeightInput& input, const HeightOptions& options, PixelRect box, const Context& context) {
  const PolarizationState& state = input.polarization;
  const ReflectionMap& reflection = input.reflection;
  const bool with_border = options.boundary == HeightBoundary::prior;
  HeightData data = empty_data(box.size(), reflection.refractive_index, input.is_perspective(options));
  if (input.camera != nullptr) data.camera = input.camera->cropped(box);
  const StokesVariances variances(state);
  parallel_rows(context, box.height(), [&](int row) {
    const int v = box.v0 + row;
    for (int column = 0; column < box.width(); ++column) {
      const int u = box.u0 + column;
      if (has_state(state.valid(u, v), PixelState::outside)) continue;
      data.object(column, row) = 255;
      HeightPixel& pixel = data.pixels(column, row);
      if (input.prior_height != nullptr) pixel.prior_height = (*input.prior_height)(u, v);
      if (with_border) pixel.border_height = pixel.prior_height;
      if (reflection.at(u, v) == Reflection::outside) continue;
      const Eigen::Vector3d stokes = state.stokes(u, v);
      const StokesVariance variance = variances(u, v, stokes);
      pixel.kind = reflection.at(u, v);
      pixel.branch = reflection.branch(u, v);
      pixel.i_un = static_cast<float>(0.5 * stokes[0]);
      pixel.s1 = static_cast<float>(stokes[1]);
      pixel.s2 = static_cast<float>(stokes[2]);
      pixel.variance_i = static_cast<float>(0.25 * variance.intensity);
      pixel.variance_s = static_cast<float>(variance.linear);
      pixel.zenith = reflection.zenith(u, v);
    }
  });
  if (!with_border) return data;
  // Only the object's own border is held, not the edges where this part is cut out of the raster.
  const auto is_object = [&](int u, int v) {
    return state.valid.contains(u, v) && !has_state(state.valid(u, v), PixelState::outside);
  };
  parallel_pixels(context, box.size(), [&](int column, int row) {
    const int u = box.u0 + column, v = box.v0 + row;
    if (is_object(u - 1, v) && is_object(u + 1, v) && is_object(u, v - 1) && is_object(u, v + 1))
      data.pixels(column, row).border_height = no_value;
  });
  return data;
}

HeightData part_of(const HeightData& whole, PixelRect box) {
  HeightData part;
  if (whole.camera) part.camera = whole.camera->cropped(box);
  part.perspective = whole.perspective;
  part.refractive_index = whole.refractive_index;
  part.object = cropped(whole.object, box);
  part.pixels = cropped(whole.pixels, box);
  return part;
}

HeightData coarsened(const HeightData& fine, const Context& context) {
  const Size size{(fine.size().width + 1) / 2, (fine.size().height + 1) / 2};
  HeightData coarse = empty_data(size, fine.refractive_index, fine.perspective);
  if (fine.camera) coarse.camera = fine.camera->binned();
  parallel_pixels(context, size,
                  [&](int column, int row) { coarsen_pixel(fine, 2 * column, 2 * row, coarse, column, row); });
  return coarse;
}

HeightData coarsened(const HeightInput& input, const HeightOptions& options, const Context& context) {
  constexpr int band_rows = 32;
  const Size fine = input.polarization.size(), size{(fine.width + 1) / 2, (fine.height + 1) / 2};
  HeightData coarse = empty_data(size, input.reflection.refractive_index, input.is_perspective(options));
  if (input.camera != nullptr) coarse.camera = input.camera->binned();
  Context inner = context;
  inner.threads = 1;
  const auto bands = static_cast<std::size_t>((fine.height + band_rows - 1) / band_rows);
  parallel_for(context, bands, 1, [&](std::size_t k, std::size_t) {
    const int top = static_cast<int>(k) * band_rows, bottom = std::min(top + band_rows, fine.height);
    const HeightData band = height_data(input, options, {0, top, fine.width, bottom}, inner);
    for (int row = top / 2; row < (bottom + 1) / 2; ++row) {
      for (int column = 0; column < size.width; ++column)
        coarsen_pixel(band, 2 * column, 2 * row - top, coarse, column, row);
    }
  });
  return coarse;
}

Image<float> refined_height(const Image<float>& coarse, const Mask& object, const Context& context) {
  Image<float> fine(object.size(), 1, no_value);
  parallel_rows(context, object.height(), [&](int v) {
    const float at_v = 0.5F * (static_cast<float>(v) - 0.5F);
    const int row = static_cast<int>(std::floor(at_v));
    for (int u = 0; u < object.width(); ++u) {
      if (object(u, v) == 0) continue;
      const float at_u = 0.5F * (static_cast<float>(u) - 0.5F);
      const int column = static_cast<int>(std::floor(at_u));
      float sum = 0, weights = 0;
      for (int k = 0; k < 4; ++k) {
        const int i = column + k % 2, j = row + k / 2;
        if (!coarse.contains(i, j) || !std::isfinite(coarse(i, j))) continue;
        const float weight =
            (1 - std::abs(at_u - static_cast<float>(i))) * (1 - std::abs(at_v - static_cast<float>(j)));
        sum += weight * coarse(i, j);
        weights += weight;
      }
      fine(u, v) = 2 * sum / weights;  // not 0: the coarse pixel that contains this one always has a height
    }
  });
  return fine;
}

}  // namespace malus
