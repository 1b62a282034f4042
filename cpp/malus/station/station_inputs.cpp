#include <variant>

#include "malus/core/parallel_internal.h"
#include "malus/io/colmap_workspace_internal.h"
#include "malus/io/sha256_internal.h"
#include "malus/station/prior_scale_internal.h"
#include "malus/station/station_inputs_internal.h"

namespace malus {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> hashes_of(const std::vector<fs::path>& paths, const Context& context) {
  std::vector<std::string> hashes(paths.size());
  parallel_for(context, paths.size(), 1,
               [&](std::size_t k, std::size_t) { hashes[k] = sha256_of_file(paths[k], "input"); });
  return hashes;
}

}  // namespace

StationInputs::Values StationInputs::of(const std::vector<Part>& parts) {
  Values values;
  taken_ = &values;
  for (const Part part : parts) values.parts.push_back((this->*part)());
  taken_ = nullptr;
  return values;
}

void StationInputs::require_unchanged(const Values& values) const {
  const std::vector<std::string> now = hashes_of(values.files, context_);
  for (std::size_t k = 0; k < now.size(); ++k) {
    if (now[k] == known_.at(values.files[k])) continue;
    throw input_error(values.files[k].string() + " was changed while it was read; run again");
  }
}

std::string StationInputs::name_of(const fs::path& path) const {
  return path.lexically_proximate(station_.file.path.parent_path()).string();
}

Json StationInputs::files(const std::vector<fs::path>& paths) {
  std::vector<fs::path> fresh;
  for (const fs::path& path : paths) {
    if (!known_.contains(path)) fresh.push_back(path);
  }
  const std::vector<std::string> hashes = hashes_of(fresh, context_);
  for (std::size_t k = 0; k < fresh.size(); ++k) known_[fresh[k]] = hashes[k];
  Json json = Json::array();
  for (const fs::path& path : paths) {
    const std::string& hash = taken_->hashes[name_of(path)] = known_.at(path);
    taken_->files.push_back(path);
    json.push_back({{"path", name_of(path)}, {"sha256", hash}});
  }
  return json;
}

/// Hash and shape of an image, or hash of a vector.
template <class T>
Json StationInputs::array(const std::string& name, const T& values) {
  context_.check_cancel();
  const auto bytes = static_cast<std::size_t>(values.end() - values.begin()) * sizeof(*values.begin());
  const std::string hash = sha256_of_bytes({reinterpret_cast<const char*>(values.data()), bytes});
  taken_->hashes[name] = hash;
  Json json = {{"sha256", hash}};
  if constexpr (requires { values.width(); }) json["shape"] = {values.height(), values.width(), values.channels()};
  return json;
}

Json StationInputs::title() {
  return {{"name", station_.file.name}, {"unit", station_.file.unit}};
}

Json StationInputs::object() {
  return fields_to_json(station_.file.object);
}

Json StationInputs::polarized() {
  const PolarizedSpec& spec = station_.file.polarized;
  Json json = fields_to_json(spec);
  json["images"] = files(spec.images);
  // A developed image's folder does not count: a result in memory is saved to a workspace, which has one of its own.
  if (!station_.developed_from.empty())
    for (Json& image : json["images"]) image["path"] = fs::path(image["path"].get<std::string>()).filename().string();
  // Recorded only: the name of a developed image depends on the content of its RAW file.
  files(station_.developed_from);
  for (std::size_t k = 0; k < station_.images.size(); ++k)
    json["images"].push_back(array("images[" + std::to_string(k) + "]", station_.images[k]));
  if (const auto table = spec.response.table()) json["response"] = file(*table);
  if (station_.whole_numbers) json["whole_numbers"] = true;
  if (spec.mask) json["mask"] = file(*spec.mask);
  if (station_.mask) json["mask"] = array("mask", *station_.mask);
  json["has_photos"] = station_.file.photos.has_value();
  if (!station_.file_findings.empty()) json["file_findings"] = fields_to_json(station_.file_findings);
  return json;
}

Json StationInputs::optics() {
  Json json = fields_to_json(station_.file.optics);
  json.erase("metal");
  if (station_.file.optics.label_image) json["label_image"] = file(*station_.file.optics.label_image);
  if (station_.labels) json["label_image"] = array("labels", *station_.labels);
  return json;
}

Json StationInputs::metal() {
  return station_.file.optics.metal;
}

Json StationInputs::lens() {
  // The files hold other cameras that do not matter: the files are recorded, but not part of the key.
  files(station_.file.camera_files);
  return fields_to_json(station_.file.known_lens());
}

Json StationInputs::camera() {
  Json json = {{"lens", lens()}};
  if (station_.file.camera) json["pose"] = fields_to_json(station_.file.camera->pose);
  return json;
}

Json StationInputs::prior() {
  struct Source {
    StationInputs& inputs;

    Json operator()(std::monostate) const { return nullptr; }
    Json operator()(const CloudFile& cloud) const {
      if (!fs::is_directory(cloud.path)) return {{"cloud", inputs.file(cloud.path)}};
      return {{"cloud", inputs.files(colmap_workspace_files(cloud.path))}};
    }
    Json operator()(const MeshFile& mesh) const { return {{"mesh", inputs.file(mesh.path)}}; }
    Json operator()(const DepthFile& depth) const { return {{"depth", inputs.file(depth.path)}}; }
    Json operator()(const Shape& shape) const {
      Json json;
      json[std::string(malus::name_of(shape))] =
          std::visit([](const auto& some) { return fields_to_json(some); }, shape);
      return json;
    }
    Json operator()(const PointCloud& cloud) const {
      Json json = {{"points", inputs.array("prior points", cloud.points)},
                   {"normals", inputs.array("prior normals", cloud.normals)},
                   {"colors", inputs.array("prior colors", cloud.colors)}};
      // A scan, which Python has read.
      const std::optional<PriorFile>& given = inputs.station_.file.prior;
      if (const auto* scan = given ? std::get_if<CloudFile>(&*given) : nullptr) json["scan"] = inputs.file(scan->path);
      return json;
    }
    Json operator()(const TriangleMesh& mesh) const {
      return {{"vertices", inputs.array("prior vertices", mesh.vertices.points)},
              {"triangles", inputs.array("prior triangles", mesh.triangles)}};
    }
    Json operator()(const Image<float>& depth) const { return {{"depth", inputs.array("prior depth", depth)}}; }
    Json operator()(const SweptDepth& swept) const {
      return {{"swept", inputs.array("swept depth", swept.depth)},
              {"sigma", inputs.array("swept sigma", swept.sigma)},
              {"shape", inputs.array("swept shape", swept.shape)},
              {"hull", inputs.array("hull", swept.hull)},
              {"hull_sigma", inputs.array("hull's sigma", swept.hull_sigma)},
              {"photos", inputs.photos()}};
    }
  };
  Json json = std::visit(Source{*this}, station_.prior);
  if (station_.file.prior_scale != 1) json["scale"] = station_.file.prior_scale;
  if (station_.file.prior_sigma) json["sigma"] = *station_.file.prior_sigma;
  return json;
}

Json StationInputs::photos() {
  if (!station_.file.photos || !station_.photogrammetry) return nullptr;
  // Recorded only: what the photogrammetry made of these files, such as the hull of masks, is part of the key itself.
  for (const auto& [path, hash] : station_.photogrammetry->files) taken_->hashes[name_of(path)] = hash;
  const Json figures = Json::parse(station_.photogrammetry->figures_json);
  const Json::json_pointer place("/photogrammetry/files");
  if (!figures.contains(place)) return nullptr;
  const Json& hashes = figures.at(place);
  for (const auto& [name, hash] : hashes.items())
    taken_->hashes[name_of(station_.file.photos->folder / name)] = hash.get<std::string>();
  return hashes;
}

Json StationInputs::regions() {
  Json json = {{"patches", fields_to_json(station_.file.patches)},
               {"profiles", fields_to_json(station_.file.profiles)}};
  if (!station_.file.control.empty()) json["control"] = fields_to_json(station_.file.control);
  if (const Json scale = scale_json(station_.file); !scale.is_null()) json["scale"] = scale;
  return json;
}

Json StationInputs::comparison() {
  Json json = Json::object();
  if (reference_) json["reference"] = file(*reference_);
  if (station_.photogrammetry) json["photogrammetry"] = Json::parse(station_.photogrammetry->figures_json);
  return json;
}

}  // namespace malus
