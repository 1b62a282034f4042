#pragma once

#include <gtest/gtest.h>

#include <string>
#include <utility>

#include "malus/core/error.h"

namespace malus {

/// Code and message of the error that a call throws.
template <class Call>
std::pair<ErrorCode, std::string> error_of(Call&& call) {
  try {
    call();
  } catch (const Error& error) {
    return {error.code(), error.what()};
  }
  ADD_FAILURE() << "no error";
  return {};
}

inline void expect_contains(const std::string& text, const std::string& part) {
  EXPECT_NE(text.find(part), std::string::npos) << text;
}

}  // namespace malus
