#pragma once

#include <stdexcept>
#include <string>

namespace malus {

/// Kind of failure; its value is the exit code of the programs (2, 3, 4, 5, 130).
enum class ErrorCode {
  input = 2,          ///< a file, field, value or command line is wrong
  data = 3,           ///< the data cannot support a result
  external = 4,       ///< an external program that Malus calls is missing or failed
  resource = 5,       ///< out of disk or memory
  interrupted = 130,  ///< canceled by the user
};

/// A failure that a user can cause. The message names file, field, value and what was expected.
class Error : public std::runtime_error {
 public:
  Error(ErrorCode code, const std::string& message) : std::runtime_error(message), code_(code) {}

  ErrorCode code() const { return code_; }

 private:
  ErrorCode code_;
};

inline Error input_error(const std::string& message) {
  return {ErrorCode::input, message};
}
inline Error data_error(const std::string& message) {
  return {ErrorCode::data, message};
}
inline Error resource_error(const std::string& message) {
  return {ErrorCode::resource, message};
}

}  // namespace malus
