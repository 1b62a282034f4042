#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <utility>
#include <vector>

#include "arrays.h"
#include "bindings.h"
#include "cameras.h"
#include "interruptible.h"
#include "malus/core/parallel_internal.h"
#include "malus/io/colmap_model_internal.h"
#include "malus/photogrammetry/control_datum_internal.h"
#include "malus/photogrammetry/epipolar_line_internal.h"
#include "malus/photogrammetry/feature_matching_internal.h"
#include "malus/photogrammetry/lens_refit_internal.h"
#include "malus/photogrammetry/model_refinement_internal.h"
#include "malus/photogrammetry/scale_adjustment_internal.h"
#include "malus/photogrammetry/target_detection_internal.h"
#include "photos.h"
#include "words.h"

namespace malus::python {
namespace {

/// Index of the photo, x, y, standard deviation in px.
using MarkValues = std::tuple<std::size_t, double, double, double>;
/// Name, distance, its standard deviation, marks of both ends, whether the distance only serves as a check.
using DistanceValues = std::tuple<std::string, double, double, std::vector<MarkValues>, std::vector<MarkValues>, bool>;

std::vector<PointMark> to_marks(const std::vector<MarkValues>& values) {
  std::vector<PointMark> marks;
  for (const auto& [view, x, y, sigma_px] : values) marks.push_back({view, {x, y}, sigma_px});
  return marks;
}

/// Name and camera of every photo.
using ViewValues = std::vector<std::pair<std::string, CameraValues>>;

std::vector<MarkedView> to_views(const ViewValues& views) {
  std::vector<MarkedView> marked;
  for (const auto& [name, values] : views) {
    auto [camera, pose] = to_camera(values, name);
    marked.push_back({name, std::move(camera), pose});
  }
  return marked;
}

/// Name, coordinates, marks, whether the point only serves as a check.
using KnownPointValues = std::tuple<std::string, Eigen::Vector3d, std::vector<MarkValues>, bool>;

py::object datum_of(const ViewValues& views, const std::vector<KnownPointValues>& values) {
  std::vector<KnownPoint> points;
  for (const auto& [name, xyz, marks, check] : values) points.push_back({name, xyz, to_marks(marks), check});
  return by_fields(adjust_datum(to_views(views), points));
}

py::object scale_of(const ViewValues& views, const std::vector<DistanceValues>& distances) {
  const std::vector<MarkedView> marked = to_views(views);
  std::vector<KnownDistance> known;
  for (const auto& [name, distance, sigma, a, b, check] : distances) {
    known.push_back({name, distance, sigma, to_marks(a), to_marks(b), check});
  }
  return by_fields(computed(1, [&](const Context& context) { return adjust_scale(marked, known, context); }));
}

/// Matches (K×2, uint32) of every pair of photos, given each photo's descriptors (N×128, uint8).
py::list matches_of(const std::vector<Array<std::uint8_t>>& photos,
                    const std::vector<std::pair<std::size_t, std::size_t>>& pairs, int threads,
                    const py::object& on_progress) {
  std::vector<Descriptors> descriptors;
  for (const auto& photo : photos) {
    if (photo.ndim() != 2 || photo.shape(1) != 128) throw py::value_error("descriptors must have the shape (N, 128)");
    descriptors.emplace_back(Eigen::Map<const Descriptors>(photo.data(), photo.shape(0), 128));
  }
  std::vector<std::vector<std::pair<std::uint32_t, std::uint32_t>>> found;
  run_interruptible(threads, on_progress, py::none(),
                    [&](const Context& context) { found = match_pairs(descriptors, pairs, context); });
  py::list result;
  for (const auto& matches : found) {
    py::array_t<std::uint32_t> array({static_cast<py::ssize_t>(matches.size()), py::ssize_t{2}});
    for (std::size_t i = 0; i < matches.size(); ++i) {
      array.mutable_at(static_cast<py::ssize_t>(i), 0) = matches[i].first;
      array.mutable_at(static_cast<py::ssize_t>(i), 1) = matches[i].second;
    }
    result.append(array);
  }
  return result;
}

/// name → (camera and pose, number of keypoints, number of keypoints that see a point)
py::dict images_of(const ColmapModel& model) {
  py::dict images;
  for (const auto& [id, image] : model.images) {
    std::size_t seen = 0;
    for (const ColmapKeypoint& keypoint : image.keypoints) seen += keypoint.point_id != ColmapKeypoint::no_point;
    images[py::str(image.name)] =
        py::make_tuple(to_values(model.cameras.at(image.camera_id), image.pose), image.keypoints.size(), seen);
  }
  return images;
}

/// Positions (N×3), reprojection errors in px (N) and numbers of observations (N) of all points.
py::tuple points_of(const ColmapModel& model) {
  const auto count = static_cast<py::ssize_t>(model.points.size());
  py::array_t<double> positions({count, py::ssize_t{3}});
  py::array_t<double> errors(count);
  py::array_t<std::int64_t> lengths(count);
  py::ssize_t row = 0;
  for (const auto& [id, point] : model.points) {
    for (int k = 0; k < 3; ++k) positions.mutable_at(row, k) = point.position[k];
    errors.mutable_at(row) = point.error_px;
    lengths.mutable_at(row) = static_cast<std::int64_t>(point.track.size());
    ++row;
  }
  return py::make_tuple(positions, errors, lengths);
}

/// Refines a model in place. pictures: image name → file or intensity. freedom: image name → which parameters of its
/// lens are adjusted, by the name of a LensFreedom.
py::dict refine(ColmapModel& model, const std::map<std::string, PhotoSource>& pictures, const std::string& preferred,
                const std::map<std::string, std::string>& freedom, const Options& options, int threads,
                const py::object& on_log) {
  std::map<std::uint32_t, LensFreedom> lenses;
  for (const auto& [name, text] : freedom)
    lenses[model.image(name, "freedom").camera_id] = named<LensFreedom>(text, "freedom");
  ModelRefinement done;
  run_interruptible(threads, py::none(), on_log, [&](const Context& context) {
    std::map<std::string, Image<float>> images;
    std::vector<std::pair<Image<float>*, const PhotoSource*>> to_read;
    for (const auto& [name, source] : pictures) to_read.emplace_back(&images[name], &source);
    parallel_for(context, to_read.size(), 1,
                 [&](std::size_t k, std::size_t) { *to_read[k].first = intensity_of(*to_read[k].second); });
    done = refine_model(model, std::move(images), preferred, lenses, options.photos, context);
  });
  py::dict result = by_fields(done);
  result.attr("update")(by_fields(done.adjustment));
  py::dict sigmas;
  for (const auto& [name, text] : freedom) {
    const auto found = done.lens_sigma.find(model.image(name, "freedom").camera_id);
    if (found != done.lens_sigma.end()) sigmas[py::str(name)] = found->second;
  }
  result["lens_sigma"] = sigmas;
  result["with_few_matches"] = done.with_few_matches;
  return result;
}

}  // namespace

void bind_photogrammetry(py::module_& module) {
  py::class_<ColmapModel>(module, "ColmapModel")
      .def_static(
          "read", [](const std::string& folder) { return read_colmap_model(folder); }, WithoutGil())
      .def(
          "write", [](const ColmapModel& model, const std::string& folder) { write_colmap_model(folder, model); },
          WithoutGil())
      .def("transform", &ColmapModel::transform)
      .def("refine", &refine)
      .def("images", &images_of)
      .def("points", &points_of);

  module.def("as_colmap_camera", [](const CameraValues& values) {
    auto [camera, pose] = to_camera(values, "camera");
    const LensRefit refit = as_colmap_camera(camera);
    return py::make_tuple(to_values(refit.camera, pose), refit.rms_px);
  });
  module.def("undistorted", [](const CameraValues& values) {
    const auto [camera, pose] = to_camera(values, "camera");
    return RasterView{camera.pinhole(), pose};
  });
  module.def("quaternion_of", &quaternion_from_rotation);
  module.def("epipolar_line", [](const CameraValues& values, double u, double v, const CameraValues& other_values) {
    const auto [camera, pose] = to_camera(values, "camera");
    const auto [other, other_pose] = to_camera(other_values, "camera");
    std::vector<std::pair<double, double>> line;
    for (const Eigen::Vector2d& at : epipolar_line(camera, pose, {u, v}, other, other_pose))
      line.emplace_back(at.x(), at.y());
    return line;
  });
  module.def(
      "detect_targets",
      [](const Image<std::uint8_t>& pixels, const std::string& dictionary) {
        std::vector<std::tuple<int, double, double>> found;
        for (const CodedTarget& target : detect_targets(pixels, named<TargetDictionary>(dictionary, "dictionary"))) {
          found.emplace_back(target.id, target.center.x(), target.center.y());
        }
        return found;
      },
      WithoutGil());
  module.def("match_pairs", &matches_of);
  module.def("adjust_scale", &scale_of);
  module.def("adjust_datum", &datum_of);
}

}  // namespace malus::python
