#pragma once

// Private to the station room: what a step writes into the workspace.

#include <filesystem>
#include <mutex>
#include <string>
#include <vector>

#include "malus/io/workspace.h"

namespace malus {

/// The files of a step. They are read again for their SHA-256: large ones by the thread that is done with them, while
/// others still write.
class StepOutputs {
 public:
  explicit StepOutputs(const Workspace& workspace) : workspace_(workspace) {}

  const std::filesystem::path& folder() const { return workspace_.folder(); }

  /// This file, by its path below the folder, is written.
  void add(const std::string& path) {
    Workspace::Output output = workspace_.examine(path);
    const std::lock_guard lock(mutex_);
    written_.push_back(std::move(output));
  }

  /// When all are written.
  const std::vector<Workspace::Output>& written() const { return written_; }

 private:
  const Workspace& workspace_;
  std::mutex mutex_;
  std::vector<Workspace::Output> written_;
};

}  // namespace malus
