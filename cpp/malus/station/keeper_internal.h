#pragma once

// Private to the station room: how a step's results become files and notes in a workspace, and results again.

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

/// The files of a step: what writes them is collected first, so that they can be written beside each other.
class StepFiles {
 public:
  using Write = std::function<bool(const std::filesystem::path& file)>;

  /// `write` writes the file of this name below the workspace, of about so many bytes; or returns false and leaves
  /// none. What it refers to must live until then.
  void add(const std::string& name, std::size_t bytes, Write write);
  /// Writes them all, on the context's threads, the largest first, and makes their folders. Returns the names of those
  /// that are there.
  std::vector<std::string> write(const std::filesystem::path& folder, const Context& context) const;

 private:
  struct Task {
    std::string name;
    std::size_t bytes;
    Write write;
  };
  std::vector<Task> tasks_;
};

/// Takes the parts of one result to the files and notes of its step, or back: each result has one function `keep` that
/// names them, and what comes back equals what went in to the bit.
class Keeper {
 public:
  /// To files that are written later, and to notes.
  Keeper(StepFiles& files, Json& notes) : files_(&files), notes_(&notes) {}
  /// Back from the folder, from those files only that the step has left. `result` gives results of other steps.
  Keeper(const std::filesystem::path& folder, const Workspace::Record& record,
         std::function<std::shared_ptr<const void>(std::type_index)> result)
      : folder_(&folder), record_(&record), result_(std::move(result)) {}

  bool is_reading() const { return record_ != nullptr; }

  /// Rasters, in the file of this name; there is none of an empty one. All of a result have one size.
  void raster(const std::string& name, Image<float>& image);
  void raster(const std::string& name, Image<std::uint8_t>& image);
  /// A whole text file.
  void text(const std::string& name, std::string& content);
  /// A text file for other programs, which is not read back.
  void extra(const std::string& name, const std::string& content);

  /// A value in the notes: what fields_to_json takes.
  template <class T>
  void value(const std::string& name, T& value) {
    if (is_reading()) {
      fields_from_json(value, record_->notes.at(name));
    } else {
      (*notes_)[name] = fields_to_json(value);
    }
  }

  /// All fields that a result lists, each as a value.
  template <class T>
  void fields(T& result) {
    T::fields(result, [this](const char* name, auto& member) { value(name, member); });
  }

  /// A part that is shared: a new one to read into, or the one that is there, which is not changed.
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
