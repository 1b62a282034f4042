#include <algorithm>
#include <cstddef>

#include "malus/capture/spline_internal.h"
#include "malus/core/parallel_internal.h"

namespace malus {
namespace {

/// Pole of the filter, √3 − 2.
constexpr double pole = -0.26794919243112270;
/// Powers of the pole beyond this one are below the precision of float.
constexpr int horizon = 14;
/// Rows that are filtered side by side, as each sample waits for the one before it.
constexpr int rows_at_once = 8;
/// Values of a row whose columns are filtered together, few enough for a processor's cache.
constexpr int columns_at_once = 128;

/// First value of the causal filter, Σ pole^k x(−k), of the point-symmetric continuation x(−k) = 2 x(0) − x(k).
/// `sample(k)`: the k-th of `count` samples.
template <class Sample>
float start_of(int count, Sample&& sample) {
  const double first = sample(0);
  double sum = first, power = pole;
  for (int k = 1; k < std::min(count, horizon); ++k, power *= pole) sum += power * (2 * first - sample(k));
  return static_cast<float>(sum);
}

/// Filters `count` samples of each of some rows, `lag` values apart. The symmetric filter leaves the last sample as it
/// is, because the continuation is point-symmetric about it.
void filter_rows(float* const* rows, int number, int count, int lag) {
  const auto gain = static_cast<float>((1 - pole) * (1 - pole)), p = static_cast<float>(pole);
  const int last = (count - 1) * lag;
  for (int c = 0; c < lag; ++c) {
    float before[rows_at_once] = {}, end[rows_at_once] = {};
    for (int r = 0; r < number; ++r) {
      const float* const row = rows[r] + c;
      before[r] = gain * start_of(count, [&](int k) { return row[static_cast<std::ptrdiff_t>(k) * lag]; });
      end[r] = row[last];
    }
    for (int r = 0; r < number; ++r) rows[r][c] = before[r];
    for (int i = c + lag; i <= last + c; i += lag) {
      for (int r = 0; r < number; ++r) rows[r][i] = before[r] = gain * rows[r][i] + p * before[r];
    }
    for (int r = 0; r < number; ++r) rows[r][last + c] = before[r] = end[r];
    for (int i = last + c - lag; i >= 0; i -= lag) {
      for (int r = 0; r < number; ++r) rows[r][i] = before[r] = rows[r][i] + p * before[r];
    }
  }
}

/// The same along columns, for the values [begin, end) of each row.
void filter_columns(Image<float>& image, int begin, int end) {
  const auto gain = static_cast<float>((1 - pole) * (1 - pole)), p = static_cast<float>(pole);
  const int count = image.height(), length = end - begin;
  const auto row = [&](int v) { return image.row(v) + begin; };
  float start[columns_at_once];
  for (int i = 0; i < length; ++i) start[i] = gain * start_of(count, [&](int k) { return row(k)[i]; });
  float last[columns_at_once];
  std::copy_n(row(count - 1), length, last);
  std::copy_n(start, length, row(0));
  for (int v = 1; v < count; ++v) {
    const float* const before = row(v - 1);
    float* const here = row(v);
    for (int i = 0; i < length; ++i) here[i] = gain * here[i] + p * before[i];
  }
  std::copy_n(last, length, row(count - 1));
  for (int v = count - 2; v >= 0; --v) {
    const float* const after = row(v + 1);
    float* const here = row(v);
    for (int i = 0; i < length; ++i) here[i] += p * after[i];
  }
}

}  // namespace

std::array<float, spline_support> spline_weights(double fraction) {
  const double f = fraction, g = 1 - fraction;
  const double weights[] = {g * g * g / 6, (4 + f * f * (3 * f - 6)) / 6, (4 + g * g * (3 * g - 6)) / 6, f * f * f / 6};
  std::array<float, spline_support> result;
  std::copy(std::begin(weights), std::end(weights), result.begin());
  return result;
}

void to_spline_coefficients(Image<float>& image, const Context& context) {
  if (image.empty()) return;
  const auto height = static_cast<std::size_t>(image.height());
  parallel_for(context, height, rows_at_once, [&](std::size_t begin, std::size_t end) {
    float* rows[rows_at_once] = {};
    for (std::size_t v = begin; v < end; ++v) rows[v - begin] = image.row(static_cast<int>(v));
    filter_rows(rows, static_cast<int>(end - begin), image.width(), image.channels());
  });
  const auto values = static_cast<std::size_t>(image.width() * image.channels());
  parallel_for(context, values, columns_at_once, [&](std::size_t begin, std::size_t end) {
    filter_columns(image, static_cast<int>(begin), static_cast<int>(end));
  });
}

}  // namespace malus
