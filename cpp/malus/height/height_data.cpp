#include <algorithm>
#include <cmath>
#include <limits>

#include "malus/core/parallel_internal.h"
#include "malus/height/height_data_internal.h"
#include "malus/polarization/fresnel.h"

namespace malus {
namespace {

constexpr float none = std::numeric_limits<float>::quiet_NaN();

HeightData empty_data(Size size, bool with_prior, bool with_border) {
  HeightData data;
  data.object = Mask(size);
  data.kind = Image<std::uint8_t>(size);
  data.above_brewster = Mask(size);
  data.i_un = data.s1 = data.s2 = data.variance_i = data.variance_s = Image<float>(size);
  data.zenith = Image<float>(size, 1, none);
  if (with_prior) data.prior_height = Image<float>(size, 1, none);
  if (with_border) data.border_height = Image<float>(size, 1, none);
  return data;
}

/// Mean of the finite ones of four heights, in pixels twice as large.
class HeightMean {
 public:
  void add(const Image<float>& heights, int u, int v) {
    if (heights.empty() || !std::isfinite(heights(u, v))) return;
    sum_ += heights(u, v);
    ++count_;
  }
  float value() const { return count_ == 0 ? none : static_cast<float>(0.5 * sum_ / count_); }

 private:
  double sum_ = 0;
  int count_ = 0;
};

/// One coarse pixel from the up to four at (column, row) of the fine raster.
void coarsen_pixel(const HeightData& fine, int column, int row, HeightData& coarse, int to_column, int to_row) {
  float i_un = 0, s1 = 0, s2 = 0, variance_i = 0, variance_s = 0;
  int object = 0, count = 0, specular = 0, above = 0;
  HeightMean prior, border;
  for (int v = row; v < std::min(row + 2, fine.size().height); ++v) {
    for (int u = column; u < std::min(column + 2, fine.size().width); ++u) {
      if (fine.object(u, v) == 0) continue;
      ++object;
      prior.add(fine.prior_height, u, v);
      border.add(fine.border_height, u, v);
      if (!fine.has_data(u, v)) continue;
      ++count;
      specular += fine.kind_at(u, v) == Reflection::specular;
      above += fine.above_brewster(u, v) != 0;
      i_un += fine.i_un(u, v);
      s1 += fine.s1(u, v);
      s2 += fine.s2(u, v);
      variance_i += fine.variance_i(u, v);
      variance_s += fine.variance_s(u, v);
    }
  }
  if (object == 0) return;
  coarse.object(to_column, to_row) = 255;
  if (!coarse.prior_height.empty()) coarse.prior_height(to_column, to_row) = prior.value();
  if (!coarse.border_height.empty()) coarse.border_height(to_column, to_row) = border.value();
  if (count == 0) return;
  const float share = 1.0F / static_cast<float>(count);
  const Reflection kind = 2 * specular > count ? Reflection::specular : Reflection::diffuse;
  const bool above_brewster = 2 * above > count;
  coarse.kind(to_column, to_row) = static_cast<std::uint8_t>(kind);
  coarse.above_brewster(to_column, to_row) = above_brewster ? 255 : 0;
  coarse.i_un(to_column, to_row) = share * i_un;
  coarse.s1(to_column, to_row) = share * s1;
  coarse.s2(to_column, to_row) = share * s2;
  coarse.variance_i(to_column, to_row) = share * share * variance_i;
  coarse.variance_s(to_column, to_row) = share * share * variance_s;
  const double degree = std::min(std::hypot(s1, s2) / (2.0 * i_un), 1.0);
  coarse.zenith(to_column, to_row) =
      static_cast<float>(zenith_of(kind, degree, fine.refractive_index,
                                   above_brewster ? SpecularBranch::above_brewster : SpecularBranch::below_brewster)
                             .zenith_rad);
}

}  // namespace

HeightData height_data(const HeightInput& input, const HeightOptions& options, PixelRect box, const Context& context) {
  const PolarizationState& state = input.polarization;
  const ReflectionMap& reflection = input.reflection;
  const bool with_border = options.boundary == HeightBoundary::prior;
  HeightData data = empty_data({box.width(), box.height()}, input.prior_height != nullptr, with_border);
  if (options.perspective && input.camera != nullptr) data.camera = input.camera->cropped(box);
  data.refractive_index = reflection.refractive_index;
  const StokesVariances variances(state);
  parallel_rows(context, box.height(), [&](int row) {
    const int v = box.v0 + row;
    for (int column = 0; column < box.width(); ++column) {
      const int u = box.u0 + column;
      if (state.valid(u, v) == static_cast<std::uint8_t>(PixelState::outside)) continue;
      data.object(column, row) = 255;
      if (input.prior_height != nullptr) data.prior_height(column, row) = (*input.prior_height)(u, v);
      if (with_border) data.border_height(column, row) = (*input.prior_height)(u, v);
      if (reflection.at(u, v) == Reflection::outside) continue;
      const Eigen::Vector3d stokes = state.stokes(u, v);
      const StokesVariance variance = variances(u, v, stokes);
      data.kind(column, row) = reflection.label(u, v);
      data.above_brewster(column, row) = reflection.branch(u, v) == SpecularBranch::above_brewster ? 255 : 0;
      data.i_un(column, row) = static_cast<float>(0.5 * stokes[0]);
      data.s1(column, row) = static_cast<float>(stokes[1]);
      data.s2(column, row) = static_cast<float>(stokes[2]);
      data.variance_i(column, row) = static_cast<float>(0.25 * variance.intensity);
      data.variance_s(column, row) = static_cast<float>(variance.linear);
      data.zenith(column, row) = reflection.zenith(u, v);
    }
  });
  if (!with_border) return data;
  // Only the object's own border is held, not where the part is cut off.
  const auto is_object = [&](int u, int v) {
    return state.valid.contains(u, v) && state.valid(u, v) != static_cast<std::uint8_t>(PixelState::outside);
  };
  parallel_rows(context, box.height(), [&](int row) {
    for (int column = 0; column < box.width(); ++column) {
      const int u = box.u0 + column, v = box.v0 + row;
      if (is_object(u - 1, v) && is_object(u + 1, v) && is_object(u, v - 1) && is_object(u, v + 1))
        data.border_height(column, row) = none;
    }
  });
  return data;
}

HeightData part_of(const HeightData& whole, PixelRect box) {
  HeightData part;
  if (whole.camera) part.camera = whole.camera->cropped(box);
  part.refractive_index = whole.refractive_index;
  part.object = cropped(whole.object, box);
  part.kind = cropped(whole.kind, box);
  part.above_brewster = cropped(whole.above_brewster, box);
  part.i_un = cropped(whole.i_un, box);
  part.s1 = cropped(whole.s1, box);
  part.s2 = cropped(whole.s2, box);
  part.variance_i = cropped(whole.variance_i, box);
  part.variance_s = cropped(whole.variance_s, box);
  part.zenith = cropped(whole.zenith, box);
  part.border_height = cropped(whole.border_height, box);
  part.prior_height = cropped(whole.prior_height, box);
  return part;
}

HeightData coarsened(const HeightData& fine, const Context& context) {
  const Size size{(fine.size().width + 1) / 2, (fine.size().height + 1) / 2};
  HeightData coarse = empty_data(size, !fine.prior_height.empty(), !fine.border_height.empty());
  if (fine.camera) coarse.camera = fine.camera->binned();
  coarse.refractive_index = fine.refractive_index;
  parallel_rows(context, size.height, [&](int row) {
    for (int column = 0; column < size.width; ++column) coarsen_pixel(fine, 2 * column, 2 * row, coarse, column, row);
  });
  return coarse;
}

HeightData coarsened(const HeightInput& input, const HeightOptions& options, const Context& context) {
  constexpr int band_rows = 32;
  const Size fine = input.polarization.size(), size{(fine.width + 1) / 2, (fine.height + 1) / 2};
  HeightData coarse = empty_data(size, input.prior_height != nullptr, options.boundary == HeightBoundary::prior);
  if (options.perspective && input.camera != nullptr) coarse.camera = input.camera->binned();
  coarse.refractive_index = input.reflection.refractive_index;
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
  Image<float> fine(object.size(), 1, none);
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
      fine(u, v) = 2 * sum / weights;  // the pixel's own coarse one is always there
    }
  });
  return fine;
}

}  // namespace malus
