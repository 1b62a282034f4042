#pragma once

#include <ceres/solver.h>

#include <string>

#include "malus/core/error.h"

namespace malus {

/// Whether Ceres found a solution, converged or not; without one the parameters keep their values. Throws a resource
/// error that begins with `problem` if the linear solver got no memory. Ceres says so only in its message.
inline bool has_solution(const ceres::Solver::Summary& summary, const std::string& problem) {
  const bool is_fatal = summary.message.find("unrecoverable non-numeric causes") != std::string::npos;
  if (summary.termination_type == ceres::FAILURE && is_fatal)
    throw resource_error(problem + ": out of memory in the linear solver; fewer threads take less");
  return summary.IsSolutionUsable();
}

}  // namespace malus
