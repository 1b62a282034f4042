#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "interruptible.h"
#include "malus/object/combine.h"
#include "malus/object/oriented_points_internal.h"
#include "malus/object/point_choice_internal.h"
#include "malus/object/sharpening.h"
#include "malus/object/station_means_internal.h"
#include "malus/object/view.h"
#include "malus/object/view_lookup_internal.h"
#include "words.h"

namespace malus::python {
namespace {

/// A view whose rasters are arrays of Python, which may be mapped files.
struct ArrayView {
  ObjectView view;
  std::vector<py::object> arrays;

  template <class T>
  PixelSpan<T> keep(Array<T> array) {
    if (array.ndim() != 2 && array.ndim() != 3) throw py::value_error("expected an array (H, W) or (H, W, C)");
    const PixelSpan<T> span(array.data(), {static_cast<int>(array.shape(1)), static_cast<int>(array.shape(0))},
                            array.ndim() == 3 ? static_cast<int>(array.shape(2)) : 1);
    arrays.push_back(std::move(array));
    return span;
  }
};
using ArrayViews = std::vector<const ArrayView*>;

std::vector<ObjectView> to_views(const ArrayViews& arrays) {
  std::vector<ObjectView> views;
  for (const ArrayView* one : arrays) views.push_back(one->view);
  return views;
}

ArrayView array_view(const std::string& name, double gsd, double shared_px, const RasterView& seen, Array<float> depth,
                     Array<float> normals, Array<float> sigma, Array<float> cosine, Array<std::uint8_t> usable,
                     Array<std::uint8_t> object) {
  ArrayView held;
  ObjectView& view = held.view;
  view.name = name;
  view.camera = seen.camera;
  view.pose = seen.pose;
  view.gsd = view.usual_sigma = gsd;
  view.shared_px = shared_px;
  view.depth = held.keep(std::move(depth));
  view.normals = held.keep(std::move(normals));
  view.sigma = held.keep(std::move(sigma));
  view.cosine = held.keep(std::move(cosine));
  view.usable = held.keep(std::move(usable));
  view.object = held.keep(std::move(object));
  view.validate();
  view.usual_sigma = usual_sigma(view);
  return held;
}

/// Moves values into an array of `columns` columns, or of none for one value a row.
template <class T, class Row>
py::array_t<T> moved_to_array(std::vector<Row>&& rows) {
  constexpr py::ssize_t columns = sizeof(Row) / sizeof(T);
  std::vector<py::ssize_t> shape{static_cast<py::ssize_t>(rows.size())};
  if (columns > 1) shape.push_back(columns);
  auto* const owner = new std::vector<Row>(std::move(rows));
  const py::capsule keep(owner, [](void* pointer) { delete static_cast<std::vector<Row>*>(pointer); });
  return py::array_t<T>(shape, reinterpret_cast<const T*>(owner->data()), keep);
}

template <class Row, class T>
std::vector<Row> copied_rows(const Array<T>& array, std::size_t count) {
  if (static_cast<std::size_t>(array.size()) * sizeof(T) != count * sizeof(Row)) {
    throw py::value_error("expected as many rows as points");
  }
  std::vector<Row> rows(count);
  std::copy_n(array.data(), array.size(), reinterpret_cast<T*>(rows.data()));
  return rows;
}

/// points, normals, sigma, stations and, if it is not 1 for all, scale.
using PointArrays =
    std::tuple<Array<double>, Array<float>, Array<float>, Array<std::uint16_t>, std::optional<Array<float>>>;

OrientedPoints to_points(const PointArrays& arrays) {
  const auto& [points, normals, sigma, stations, scale] = arrays;
  const auto count = static_cast<std::size_t>(points.shape(0));
  return {copied_rows<Eigen::Vector3d>(points, count), copied_rows<Eigen::Vector3f>(normals, count),
          copied_rows<float>(sigma, count), copied_rows<std::uint16_t>(stations, count),
          scale ? copied_rows<float>(*scale, count) : std::vector<float>()};
}

PointArrays to_arrays(OrientedPoints&& points) {
  std::optional<Array<float>> scale;
  if (!points.scale.empty()) scale = moved_to_array<float>(std::move(points.scale));
  return {moved_to_array<double>(std::move(points.points)), moved_to_array<float>(std::move(points.normals)),
          moved_to_array<float>(std::move(points.sigma)), moved_to_array<std::uint16_t>(std::move(points.stations)),
          std::move(scale)};
}

using AgreementArrays = std::tuple<std::string, py::object, Array<double>, Array<double>, std::size_t>;

AgreementArrays to_arrays(Agreement&& one) {
  return {one.view, to_array(std::move(one.ratio)), moved_to_array<double>(std::move(one.distances)),
          moved_to_array<double>(std::move(one.expected)), one.contradictions};
}

std::pair<PointArrays, std::vector<AgreementArrays>> to_arrays(CombinedViews&& combined) {
  std::vector<AgreementArrays> agreements;
  for (Agreement& one : combined.agreements) agreements.push_back(to_arrays(std::move(one)));
  return {to_arrays(std::move(combined.points)), std::move(agreements)};
}

py::dict figures_of(const std::vector<std::tuple<Array<double>, Array<double>, std::size_t>>& distances, double gsd) {
  std::vector<Agreement> agreements;
  for (const auto& [apart, expected, contradictions] : distances) {
    agreements.push_back({{}, {}, {apart.data(), apart.data() + apart.size()}, {}, contradictions});
    agreements.back().expected = copied_rows<double>(expected, agreements.back().distances.size());
  }
  return by_fields(agreement_figures(agreements, gsd));
}

using Rows3 = Eigen::Ref<const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>>;
using Integers = Eigen::Ref<const Eigen::VectorXi>;

Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor> points_at(const ArrayView& held, const Integers& rows,
                                                                    const Integers& columns) {
  const auto [width, height] = held.view.camera.size;
  Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor> points(rows.size(), 3);
  for (Eigen::Index i = 0; i < rows.size(); ++i) {
    const int u = columns[i], v = rows[i];
    if (u < 0 || v < 0 || u >= width || v >= height) throw input_error(held.view.name + ": pixel is outside the image");
    points.row(i) = point_at(held.view, u, v);
  }
  return points;
}

/// Row, column and cosine of the places that a view sees; the first pixel and 0 for the others.
std::tuple<Eigen::VectorXi, Eigen::VectorXi, Eigen::VectorXd> sights(const ArrayView& held, const Rows3& points,
                                                                     const Rows3& normals) {
  const Eigen::Index count = points.rows();
  Eigen::VectorXi rows = Eigen::VectorXi::Zero(count), columns = rows;
  Eigen::VectorXd cosines = Eigen::VectorXd::Zero(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const auto at = sight(held.view, points.row(i), normals.row(i));
    if (!at) continue;
    rows[i] = at->v;
    columns[i] = at->u;
    cosines[i] = at->cosine;
  }
  return {std::move(rows), std::move(columns), std::move(cosines)};
}

void bind_view(py::module_& module) {
  py::class_<ArrayView>(module, "ObjectView")
      .def(py::init(&array_view))
      .def_property_readonly("eye", [](const ArrayView& held) -> Eigen::Vector3d { return held.view.pose.center(); })
      .def("points_at", &points_at, WithoutGil())
      .def("sights", &sights, WithoutGil())
      .def("may_see", [](const ArrayView& held, const Eigen::Vector3d& low,
                         const Eigen::Vector3d& high) { return may_see(held.view, Eigen::AlignedBox3d(low, high)); })
      .def("resolves_more",
           [](const ArrayView& held, const ArrayView& other) { return resolves_more(held.view, other.view); })
      .def("finer",
           [](const ArrayView& held, const Eigen::VectorXd& cosines, const ArrayView& other,
              const Eigen::VectorXd& other_cosines) -> Eigen::Array<bool, Eigen::Dynamic, 1> {
             return cosines.binaryExpr(other_cosines, [&](double own, double others) {
               return is_finer(held.view, own, other.view, others);
             });
           });
  module.def("view_maps", [](const FusedSurface& surface, double most_sigma_gsd, int threads) {
    ViewMaps maps =
        computed(threads, [&](const Context& context) { return view_maps(surface, most_sigma_gsd, context); });
    py::dict result;
    result["normals"] = std::move(maps.normals);
    result["sigma"] = std::move(maps.sigma);
    result["cosine"] = std::move(maps.cosine);
    result["usable"] = std::move(maps.usable);
    result["object"] = std::move(maps.object);
    return result;
  });
  module.def("median_gsd", &median_gsd);
  module.def("most_sigma_gsd", &most_sigma_gsd);
  module.def("shared_px", &shared_px);
}

void bind_points(py::module_& module) {
  module.attr("finest_level") = finest_level;
  module.def("scales_of", &scales_of);
  module.def("levels_of", [](const Eigen::VectorXd& scales) -> Eigen::Matrix<std::int64_t, Eigen::Dynamic, 1> {
    return scales.unaryExpr([](double scale) { return std::int64_t{level_of(scale)}; });
  });
  module.def("agreement_figures", &figures_of);
  module.def("agreement", [](const ArrayViews& views, std::size_t which, int threads) {
    if (which >= views.size()) throw py::index_error("there is no view of this number");
    return to_arrays(computed(
        threads, [&](const Context& context) { return station_means(to_views(views), which, 1, context).agreement; }));
  });
  module.def("combine", [](const ArrayViews& views, const std::optional<PointArrays>& cloud, int threads) {
    const OrientedPoints stereo = cloud ? to_points(*cloud) : OrientedPoints();
    return to_arrays(
        computed(threads, [&](const Context& context) { return combine(to_views(views), stereo, context); }));
  });
  module.def("object_points", [](const ArrayViews& views, const std::vector<PointArrays>& clouds, int threads) {
    std::vector<OrientedPoints> stereo;
    for (const PointArrays& cloud : clouds) stereo.push_back(to_points(cloud));
    return to_arrays(
        computed(threads, [&](const Context& context) { return object_points(to_views(views), stereo, context); }));
  });
  module.def("unseen_stereo",
             [](const PointArrays& cloud, const ArrayViews& views, const PointArrays& seen_points, int threads) {
               const OrientedPoints stereo = to_points(cloud), seen = to_points(seen_points);
               return to_arrays(computed(threads, [&](const Context& context) {
                 return unseen_stereo(stereo, to_views(views), seen, context);
               }));
             });
}

/// Views with the maps of their phases, 2×H×W each.
using PhasedArrays = std::vector<std::pair<const ArrayView*, Array<float>>>;

std::vector<PhasedView> to_phased(const PhasedArrays& arrays) {
  std::vector<PhasedView> stations;
  for (const auto& [held, phases] : arrays) {
    const Size size = held->view.camera.size;
    if (phases.ndim() != 3 || phases.shape(0) != 2 || phases.shape(1) != size.height || phases.shape(2) != size.width) {
      throw py::value_error(held->view.name + ": expected phases (2, H, W) of the view's size");
    }
    stations.push_back({held->view, {phases.data(), size}, {phases.data() + size.area(), size}});
  }
  return stations;
}

void bind_sharpening(py::module_& module) {
  module.def("phase_maps", [](const Image<float>& degree, const Image<float>& phase) {
    PhaseMaps maps = phase_maps(degree, phase);
    return std::pair(std::move(maps.cosine), std::move(maps.sine));
  });
  module.def("is_telling", [](const ArrayView& view, const Array<float>& phases, int threads) {
    const std::vector<PhasedView> station = to_phased({{&view, phases}});
    return computed(threads, [&](const Context& context) { return is_telling(station[0], context); });
  });
  module.def("sharpened", [](const ArrayView& view, const PhasedArrays& stations, int threads) {
    const std::vector<PhasedView> phased = to_phased(stations);
    SharpenedMaps moved =
        computed(threads, [&](const Context& context) { return sharpened(view.view, phased, context); });
    return std::pair(std::move(moved.depth), std::move(moved.normals));
  });
}

}  // namespace

void bind_object(py::module_& module) {
  bind_view(module);
  bind_points(module);
  bind_sharpening(module);
}

}  // namespace malus::python
