#pragma once

// Private to the station room: writes a step's results to files and notes in a workspace, and reads them back.

#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <typeindex>
#include <vector>

#include "malus/core/context.h"
#include "malus/core/image.h"
#include "malus/io/workspace_internal.h"
#include "malus/station/json_fields_internal.h"

namespace malus {

/// The files of a step. Write functions are collected first, so that the files can be written in parallel.
class StepFiles {
 public:
  using Write = std::function<bool(const std::filesystem::path& file)>;

  /// `write` writes the file `name` below the workspace, of about `bytes` bytes, or returns false and leaves no file.
  /// Data that it refers to must live until StepFiles::write returns.
  void add(const std::string& name, std::size_t bytes, Write write);
  /// Writes all files on the context's threads, the largest first, and makes their folders. Returns the names of the
  /// files that exist then.
  std::vector<std::string> write(const std::filesystem::path& folder, const Context& context) const;

 private:
  struct Task {
    std::string name;
    std::size_t bytes;
    Write write;
  };
  std::vector<Task> tasks_;
};

/// Writes the parts of one result to the files and notes of its step, or reads them back. Each result has one function
/// `keep` that names its parts. A part that is read back equals the written one to the bit.
class Keeper {
 public:
  /// For writing: to files that are written later, and to notes.
  Keeper(StepFiles& files, Json& notes) : files_(&files), notes_(&notes) {}
  /// For reading from the folder, only from files that the step has left. `result` returns results of other steps.
  Keeper(const std::filesystem::path& folder, const Workspace::Record& record,
         std::function<std::shared_ptr<const void>(std::type_index)> result)
      : folder_(&folder), record_(&record), result_(std::move(result)) {}

  bool is_reading() const { return record_ != nullptr; }

  /// A raster in the file `name`; an empty raster has no file. All rasters of a result have the same size.
  void raster(const std::string& name, Image<float>& image);
  void raster(const std::string& name, Image<std::uint8_t>& image);
  /// A whole text file.
  void text(const std::string& name, std::string& content);
  /// A text file for other programs; not read back.
  void extra(const std::string& name, const std::string& content);

  /// A value in the notes, of any type that fields_to_json takes.
  template <class T>
  void value(const std::string& name, T& value) {
    if (is_reading()) {
      fields_from_json(value, record_->notes.at(name));
    } else {
      (*notes_)[name] = fields_to_json(value);
    }
  }

  /// All listed fields of a result, each as a value.
  template <class T>
  void fields(T& result) {
    T::fields(result, [this](const char* name, auto& member) { value(name, member); });
  }

  /// A shared part. Reading: a new object to read into. Writing: the existing object, which is not changed.
  template <class T>
  T& shared(std::shared_ptr<const T>& part) {
    if (!is_reading()) return const_cast<T&>(*part);
    auto fresh = std::make_shared<T>();
    part = fresh;
    return *fresh;
  }

  /// While reading: the result of another step.
  template <class T>
  std::shared_ptr<const T> result() const {
    return std::static_pointer_cast<const T>(result_(typeid(T)));
  }

 private:
  template <class T, class Read, class Write>
  void raster_file(const std::string& name, Image<T>& image, Read&& read, Write&& write);
  /// Whether the step left this file.
  bool has(const std::string& name) const;

  StepFiles* files_ = nullptr;
  Json* notes_ = nullptr;
  const std::filesystem::path* folder_ = nullptr;
  const Workspace::Record* record_ = nullptr;
  std::function<std::shared_ptr<const void>(std::type_index)> result_;
  Size size_;
};

}  // namespace malus
