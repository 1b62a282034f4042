#pragma once

#include <gtest/gtest.h>

#include <initializer_list>
#include <string>

#include "malus/core/error.h"

namespace malus {

/// Calls `action`, expects a malus::Error with this code whose message contains every one of `parts`.
template <class Action, class... Parts>
void expect_error(ErrorCode code, Action&& action, const Parts&... parts) {
  try {
    action();
  } catch (const Error& error) {
    EXPECT_EQ(static_cast<int>(error.code()), static_cast<int>(code)) << error.what();
    const std::string message = error.what();
    for (const std::string& part : std::initializer_list<std::string>{std::string(parts)...}) {
      EXPECT_NE(message.find(part), std::string::npos) << "\"" << part << "\" is not in: " << message;
    }
    return;
  }
  ADD_FAILURE() << "no error, expected one";
}

inline void expect_contains(const std::string& text, const std::string& part) {
  EXPECT_NE(text.find(part), std::string::npos) << text;
}

}  // namespace malus
