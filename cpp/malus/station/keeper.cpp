#include <algorithm>
#include <functional>

#include "malus/core/parallel_internal.h"
#include "malus/io/atomic_file_internal.h"
#include "malus/io/image_file_internal.h"
#include "malus/io/input_file_internal.h"
#include "malus/station/keeper_internal.h"

namespace malus {

namespace fs = std::filesystem;

void StepFiles::add(const std::string& name, std::size_t bytes, Write write) {
  tasks_.push_back({name, bytes, std::move(write)});
}

std::vector<std::string> StepFiles::write(const fs::path& folder, const Context& context) const {
  std::vector<const Task*> tasks;
  for (const Task& task : tasks_) {
    create_folder((folder / task.name).parent_path());
    tasks.push_back(&task);
  }
  std::ranges::stable_sort(tasks, std::greater<>(), &Task::bytes);
  std::vector<char> written(tasks.size());
  parallel_for(context, tasks.size(), 1,
               [&](std::size_t k, std::size_t) { written[k] = tasks[k]->write(folder / tasks[k]->name); });
  std::vector<std::string> names;
  for (std::size_t k = 0; k < tasks.size(); ++k) {
    if (written[k] != 0) names.push_back(tasks[k]->name);
  }
  return names;
}

template <class T, class Read, class Write>
void Keeper::raster_file(const std::string& name, Image<T>& image, Read&& read, Write&& write) {
  if (is_reading()) {
    if (!has(name)) return;
    image = read(*folder_ / name);
    if (size_ == Size{}) size_ = image.size();
    require_size(image, size_, (*folder_ / name).string());
  } else if (!image.empty()) {
    // Byte rasters are compressed, which takes as long as writing many more bytes.
    const std::size_t effort = image.count() * (sizeof(T) == 1 ? 8 : sizeof(T));
    files_->add(name, effort, [&image, write](const fs::path& file) {
      write(file, image);
      return true;
    });
  }
}

void Keeper::raster(const std::string& name, Image<float>& image) {
  raster_file(
      name, image, [](const fs::path& file) { return read_float_raster(file); }, write_float_tiff);
}

void Keeper::raster(const std::string& name, Image<std::uint8_t>& image) {
  raster_file(
      name, image, [](const fs::path& file) { return read_labels(file); },
      [](const fs::path& file, const Image<std::uint8_t>& values) { write_png(file, values); });
}

void Keeper::text(const std::string& name, std::string& content) {
  if (is_reading()) {
    content = read_file(*folder_ / name, "result");
  } else {
    extra(name, content);
  }
}

void Keeper::extra(const std::string& name, const std::string& content) {
  if (is_reading()) return;
  files_->add(name, content.size(), [content](const fs::path& file) {
    write_file(file, content);
    return true;
  });
}

bool Keeper::has(const std::string& name) const {
  return std::ranges::find(record_->outputs, name, &Workspace::Output::path) != record_->outputs.end();
}

}  // namespace malus
