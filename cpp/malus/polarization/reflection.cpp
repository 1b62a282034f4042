#include <algorithm>
#include <cmath>
#include <optional>
#include <string>

#include "malus/core/cell_values_internal.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/parallel_internal.h"
#include "malus/core/pixel_rect_internal.h"
#include "malus/core/refractive_index_internal.h"
#include "malus/polarization/ray_frame.h"
#include "malus/polarization/reflection_internal.h"

namespace malus {
namespace {

/// Slopes of the prior at a pixel, or nothing where the prior has no normal or faces away.
std::optional<Slopes> prior_slopes(const Image<float>& normals, const Pinhole* camera, int u, int v) {
  const Eigen::Vector3d normal(normals(u, v, 0), normals(u, v, 1), normals(u, v, 2));
  const RayFrame frame = ray_frame(camera, u, v);
  if (!(normal.dot(frame.view) > 0.01)) return std::nullopt;
  return frame.slopes(normal);
}

/// Evidence of the azimuth test: weights (sin²θ of the prior), and the part of them where R < 0.
struct Evidence {
  double weight = 0;
  double specular = 0;

  Evidence& operator+=(const Evidence& other) {
    weight += other.weight;
    specular += other.specular;
    return *this;
  }
};

Evidence evidence_at(const PolarizationState& state, const Pinhole* camera, const Image<float>& normals, int u, int v) {
  if (!state.is_valid(u, v)) return {};
  const auto slopes = prior_slopes(normals, camera, u, v);
  if (!slopes) return {};
  const double weight = slopes->tan2() / (1 + slopes->tan2());
  const double radial = std::cos(2 * (state.phi(u, v) - slopes->azimuth_rad()));
  return {weight, radial < 0 ? weight : 0};
}

/// Share of specular evidence around each pixel: cells of region_px, smoothed over their neighbors, interpolated.
class PooledEvidence {
 public:
  PooledEvidence(const PolarizationState& state, const Pinhole* camera, const Image<float>& normals,
                 const ReflectionOptions& options, const Context& context)
      : cell_px_(options.region_px) {
    const Size cells = cells_over(state.size(), cell_px_);
    Image<Evidence> sums(cells);
    parallel_pixels(context, cells, [&](int x, int y) {
      for_each_pixel(cell_rect(x, y, cell_px_, state.size()),
                     [&](int u, int v) { sums(x, y) += evidence_at(state, camera, normals, u, v); });
    });
    Evidence all;
    for (const Evidence& cell : sums) all += cell;
    const double overall = all.weight > 0 ? all.specular / all.weight : 0.0;
    const double lean = options.region_strength * cell_px_ * cell_px_;
    share_ = Image<float>(cells);
    for_each_pixel(cells, [&](int x, int y) {
      Evidence pooled{lean, lean * overall};
      for_each_pixel(square_about(x, y, 1, cells), [&](int i, int j) {
        const double tent = (i == x ? 1.0 : 0.5) * (j == y ? 1.0 : 0.5);
        pooled += {tent * sums(i, j).weight, tent * sums(i, j).specular};
      });
      share_(x, y) = pooled.weight > 0 ? static_cast<float>(pooled.specular / pooled.weight) : 0.0f;
    });
  }

  double specular_share(int u, int v) const { return between_cells(share_, cell_px_, u, v); }

 private:
  int cell_px_;
  Image<float> share_;
};

/// Without a prior: whether enough pixels are polarized more strongly than diffuse reflection can be.
bool exceeds_diffuse(const PolarizationState& state, const ReflectionOptions& options) {
  const double largest = largest_diffuse_degree(options.refractive_index);
  std::size_t valid = 0, beyond = 0;
  for (std::size_t i = 0; i < state.rho.count(); ++i) {
    if (!has_state(state.valid[i], PixelState::valid)) continue;
    ++valid;
    if (state.rho[i] > largest) ++beyond;
  }
  return static_cast<double>(beyond) > options.beyond_diffuse_share * static_cast<double>(valid);
}

void validate(const PolarizationState& state, const Image<float>* prior_normals, const Image<std::uint8_t>* labels,
              const ReflectionOptions& options) {
  validate_fields(options, "reflection");
  accepted_refractive_index(options.refractive_index, "optics.refractive_index");
  if (prior_normals != nullptr) {
    require_size(*prior_normals, state.size(), "prior normals");
    if (prior_normals->channels() != 3) throw input_error("prior normals: expected 3 channels");
  }
  if (options.reflection != ReflectionChoice::labels) return;
  if (labels == nullptr) throw input_error("optics.reflection = \"labels\" needs a label image");
  require_labels(*labels, state.size());
}

}  // namespace

void require_labels(const Image<std::uint8_t>& labels, const Size& size, const std::string& name) {
  require_size(labels, size, name);
  for (const std::uint8_t value : labels) {
    if (value > 2) {
      throw input_error(name + " has the value " + std::to_string(value) +
                        ", expected 0 (decide), 1 (diffuse) or 2 (specular)");
    }
  }
}

ReflectionMap map_reflection(const PolarizationState& state, const Pinhole* camera, const Image<float>* prior_normals,
                             const Image<std::uint8_t>* labels, const ReflectionOptions& options,
                             const Context& context) {
  validate(state, prior_normals, labels, options);
  const bool decide =
      options.reflection == ReflectionChoice::automatic || options.reflection == ReflectionChoice::labels;
  std::optional<PooledEvidence> evidence;
  Reflection everywhere = Reflection::diffuse;
  if (decide && prior_normals != nullptr) {
    evidence.emplace(state, camera, *prior_normals, options, context);
  } else if (options.reflection == ReflectionChoice::specular || (decide && exceeds_diffuse(state, options))) {
    everywhere = Reflection::specular;
  }

  ReflectionMap map;
  map.refractive_index = options.refractive_index;
  map.label = Image<std::uint8_t>(state.size());
  map.zenith = Image<float>(state.size(), 1, no_value);
  const double brewster_slope = options.refractive_index;  // tan of Brewster's angle
  const auto label_rows = [&](std::size_t begin, std::size_t end) {
    std::size_t clamped = 0;
    for (int v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
      for (int u = 0; u < state.size().width; ++u) {
        if (!state.is_valid(u, v)) continue;
        Reflection label = everywhere;
        if (evidence) label = evidence->specular_share(u, v) > 0.5 ? Reflection::specular : Reflection::diffuse;
        if (options.reflection == ReflectionChoice::labels && (*labels)(u, v) != 0) {
          label = static_cast<Reflection>((*labels)(u, v));
        }
        auto branch = SpecularBranch::below_brewster;
        if (label == Reflection::specular && prior_normals != nullptr) {
          const auto slopes = prior_slopes(*prior_normals, camera, u, v);
          if (slopes && slopes->tan2() > brewster_slope * brewster_slope) branch = SpecularBranch::above_brewster;
        }
        const auto zenith = zenith_of(label, state.rho(u, v), options.refractive_index, branch);
        map.label(u, v) = static_cast<std::uint8_t>(label);
        map.zenith(u, v) = static_cast<float>(zenith.zenith_rad);
        clamped += zenith.clamped ? 1 : 0;
      }
    }
    return clamped;
  };
  const std::size_t clamped =
      parallel_sum(context, static_cast<std::size_t>(state.size().height), 16, std::size_t{0}, label_rows);
  const auto labeled = static_cast<double>(count_of_set(map.label));
  if (labeled > 0) {
    const auto specular = std::ranges::count(map.label, static_cast<std::uint8_t>(Reflection::specular));
    map.specular_share = static_cast<double>(specular) / labeled;
    map.clamped_share = static_cast<double>(clamped) / labeled;
  }
  return map;
}

}  // namespace malus
