#include <cmath>

#include "malus/core/even_choice_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/square_internal.h"
#include "malus/fusion/refinement_image_internal.h"

namespace malus {
namespace {

/// Pixel data of a station.
class StationPixels {
 public:
  StationPixels(const PolarizationState& state, const DepthPrior& prior, Mask pixels, double log_depth_origin)
      : state_(state),
        prior_(prior),
        pixels_(std::move(pixels)),
        focal_(prior.camera.focal()),
        log_depth_origin_(log_depth_origin),
        variances_(state) {}

  PixelData operator()(int u, int v) const {
    PixelData pixel = node(u, v);
    if (!pixels_(u, v)) return pixel;
    const Eigen::Vector3d stokes = state_.stokes(u, v);
    pixel.s0 = static_cast<float>(stokes[0]);
    pixel.s1 = static_cast<float>(stokes[1]);
    pixel.s2 = static_cast<float>(stokes[2]);
    pixel.variance = static_cast<float>(variances_(u, v, stokes).linear);
    return pixel;
  }

 private:
  bool has(int u, int v) const { return pixels_.contains(u, v) && pixels_(u, v) != 0; }
  double x_of(int u, int v) const {
    return focal_ * (std::log(static_cast<double>(prior_.depth(u, v))) - log_depth_origin_);
  }

  /// The prior at a node: mean over the object's pixels around it, extrapolated by their slopes at the object's border.
  PixelData node(int u, int v) const {
    double x = 0, sigma = 0;
    int count = 0, known = 0;
    const bool inside = has(u - 1, v - 1) && has(u, v - 1) && has(u - 1, v) && has(u, v);
    for (int k = 0; k < 4; ++k) {
      const int side_u = k % 2, side_v = k / 2, pu = u - side_u, pv = v - side_v;
      if (!has(pu, pv)) continue;
      const double here = x_of(pu, pv);
      x += here;
      ++count;
      if (!inside) {
        const int far_u = pu + (side_u == 0 ? 1 : -1), far_v = pv + (side_v == 0 ? 1 : -1);
        if (has(far_u, pv)) x += 0.5 * (here - x_of(far_u, pv));
        if (has(pu, far_v)) x += 0.5 * (here - x_of(pu, far_v));
      }
      const double known_sigma = prior_.sigma.empty() ? no_value : prior_.sigma(pu, pv);
      if (!std::isfinite(known_sigma)) continue;
      sigma += known_sigma / (prior_.depth(pu, pv) / focal_);
      ++known;
    }
    PixelData data;
    data.x_prior = x / count;
    if (known > 0) data.prior_sigma = static_cast<float>(sigma / known);
    return data;
  }

  const PolarizationState& state_;
  const DepthPrior& prior_;
  Mask pixels_;
  double focal_, log_depth_origin_;
  StokesVariances variances_;
};

double mean_log_depth(const Mask& pixels, const DepthPrior& prior) {
  if (count_of_set(pixels) == 0) throw data_error("refine: the prior has a depth on no pixel of the object");
  return mean_over(pixels, [&](int u, int v) { return std::log(static_cast<double>(prior.depth(u, v))); });
}

}  // namespace

RefinementField RefinementImage::part(const PixelRect& rect, const Context& context) const {
  RefinementField field;
  field.camera = camera.cropped(rect);
  field.log_depth_origin = log_depth_origin;
  field.object = cropped(object, rect);
  field.usable = cropped(usable, rect);
  field.x = cropped(x, rect);
  field.kind = cropped(kind, rect);
  if (!other_finish.empty()) field.other_finish = cropped(other_finish, rect);
  field.reflection = reflection;
  field.shading = shading;
  const Size size = rect.size();
  field.x_prior = Image<double>::uninitialized(size);
  for (Image<float>* raster : {&field.prior_sigma, &field.s0, &field.s1, &field.s2, &field.variance, &field.mirror_body,
                               &field.stokes_precision, &field.regional_weight, &field.log_body})
    *raster = Image<float>::uninitialized(size);
  parallel_pixels(context, size, [&](int u, int v) {
    const PixelData pixel = field.object(u, v) ? source(rect.u0 + u, rect.v0 + v)
                                               : PixelData{no_value, no_value, no_value, no_value, no_value, no_value};
    field.x_prior(u, v) = pixel.x_prior;
    field.prior_sigma(u, v) = pixel.prior_sigma;
    field.s0(u, v) = pixel.s0;
    field.s1(u, v) = pixel.s1;
    field.s2(u, v) = pixel.s2;
    field.variance(u, v) = pixel.variance;
    field.mirror_body(u, v) = field.stokes_precision(u, v) = 0;
    field.regional_weight(u, v) = 1;
    field.log_body(u, v) = no_value;
  });
  field.block_weight = field.block_mean = Image<float>(field.block_count());
  return field;
}

Image<double> RefinementImage::prior_surface(const Context& context) const {
  Image<double> x_prior(size(), 1, no_value);
  parallel_pixels(context, object, [&](int u, int v) { x_prior(u, v) = source(u, v).x_prior; });
  return x_prior;
}

namespace {

/// RefinementImage::noise_share. Pixels that do not follow the sinusoid are not valid.
double measured_noise(const PolarizationState& state) {
  double sum = 0, count = 0;
  for (std::size_t i = 0; i < state.residual.count(); ++i) {
    if (!has_state(state.valid[i], PixelState::valid) || !std::isfinite(state.residual[i])) continue;
    sum += square(static_cast<double>(state.residual[i]));
    ++count;
  }
  return count > 0 ? std::min(sum / count, 1.0) : 0;
}

}  // namespace

RefinementImage make_image(const PolarizationState& state, const DepthPrior& prior, const Context& context) {
  const Size size = state.size();
  require_size(prior.depth, size, "the prior's depth");
  if (!prior.sigma.empty()) require_size(prior.sigma, size, "the prior's sigma");
  RefinementImage image;
  image.camera = prior.camera;
  const Size nodes{size.width + 1, size.height + 1};
  image.pixels = image.usable = Mask(nodes);
  parallel_pixels(context, size, [&](int u, int v) {
    const bool known = !has_state(state.valid(u, v), PixelState::outside);
    if (!known || !(prior.depth(u, v) > 0) || !std::isfinite(prior.depth(u, v))) return;
    image.pixels(u, v) = 255;
    const Eigen::Vector3d stokes = state.stokes(u, v);
    image.usable(u, v) = state.is_valid(u, v) && stokes[0] > 0 && stokes.allFinite() ? 255 : 0;
  });
  image.noise_share = measured_noise(state);
  image.object = nodes_of(image.pixels);
  image.log_depth_origin = mean_log_depth(image.pixels, prior);
  image.source = StationPixels(state, prior, image.pixels, image.log_depth_origin);
  image.x = image.prior_surface(context);
  image.kind = Image<Reflection>(nodes);
  return image;
}

StripField strip_field(const RefinementImage& image, RowRange rows, int margin, const Context& context) {
  const int begin = std::max(rows.begin - margin, 0), end = std::min(rows.end + margin, image.size().height);
  return {image.part({0, begin, image.size().width, end}, context), begin, {rows.begin - begin, rows.end - begin}};
}

}  // namespace malus
