#pragma once

#include "malus/core/fields.h"

namespace malus {

struct EvidenceOptions {
  bool refuse = true;

  template <class Self, class Visitor>
  static void fields(Self& self, Visitor&& visit) {
    visit("refuse", self.refuse, any_value,
          "end the run where an input is certainly wrong; false: go on, and say that the result has low confidence");
  }
};

}  // namespace malus
