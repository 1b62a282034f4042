#include "malus/capture/mosaic.h"

#include "malus/core/parallel.h"

namespace malus {
namespace {

/// Samples of one channel that make pixel `at` along one axis, and their weights. Samples sit at first, first + 2, ….
struct AxisSamples {
  std::array<int, 4> index;
  std::array<double, 4> weight;
  int count;
};

AxisSamples axis_samples(int at, int first, int length) {
  if ((at - first) % 2 == 0) return {{at, at, at, at}, {1, 0, 0, 0}, 1};
  const int last = length - 2 + first;
  const auto mirrored = [&](int i) { return i < first ? 2 * first - i : i > last ? 2 * last - i : i; };
  return {{mirrored(at - 3), mirrored(at - 1), mirrored(at + 1), mirrored(at + 3)},
          {-1.0 / 16, 9.0 / 16, 9.0 / 16, -1.0 / 16},
          4};
}

MosaicChannel channel_at(const Image<float>& mosaic, const Mask& saturated, int first_u, int first_v,
                         const Context& context) {
  MosaicChannel channel{Image<float>(mosaic.size()), Mask(mosaic.size())};
  parallel_rows(context, mosaic.height(), [&](int v) {
    const AxisSamples rows = axis_samples(v, first_v, mosaic.height());
    for (int u = 0; u < mosaic.width(); ++u) {
      const AxisSamples columns = axis_samples(u, first_u, mosaic.width());
      double sum = 0;
      bool flag = false;
      for (std::size_t j = 0; j < static_cast<std::size_t>(rows.count); ++j) {
        for (std::size_t i = 0; i < static_cast<std::size_t>(columns.count); ++i) {
          sum += rows.weight[j] * columns.weight[i] * mosaic(columns.index[i], rows.index[j]);
          flag = flag || saturated(columns.index[i], rows.index[j]) != 0;
        }
      }
      channel.intensity(u, v) = static_cast<float>(sum);
      channel.saturated(u, v) = flag ? 255 : 0;
    }
  });
  return channel;
}

}  // namespace

std::array<MosaicChannel, 4> demosaic(const Image<float>& mosaic, const Mask& saturated, const std::string& name,
                                      const Context& context) {
  const Size size = mosaic.size();
  if (mosaic.channels() != 1) throw input_error(name + ": a polarization mosaic has one channel, this image has 3");
  if (size.width % 2 != 0 || size.height % 2 != 0 || size.width < 8 || size.height < 8) {
    throw input_error(name + " is " + to_string(size) +
                      " pixels; a mosaic of 2 x 2 cells has an even width and height of at least 8");
  }
  require_size(saturated, size, name + " (saturation flags)");
  return {channel_at(mosaic, saturated, 0, 0, context), channel_at(mosaic, saturated, 1, 0, context),
          channel_at(mosaic, saturated, 0, 1, context), channel_at(mosaic, saturated, 1, 1, context)};
}

}  // namespace malus
