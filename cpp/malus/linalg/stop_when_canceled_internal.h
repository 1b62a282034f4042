#pragma once

#include <ceres/iteration_callback.h>

#include "malus/core/context.h"

namespace malus {

/// Ends Ceres' solution after the step in which the run is canceled. For rooms that use Ceres.
class StopWhenCanceled final : public ceres::IterationCallback {
 public:
  explicit StopWhenCanceled(const Context& context) : context_(context) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary&) override {
    return context_.canceled() ? ceres::SOLVER_ABORT : ceres::SOLVER_CONTINUE;
  }

 private:
  const Context& context_;
};

}  // namespace malus
