#pragma once

// Private to the io room: toml++.

/// Turns assertions of toml++ off, also in debug builds: where the library is used as headers only, its parser asserts
/// on malformed files, such as "a = [[}", for which its next lines throw an error.
#define TOML_ASSERT(condition) static_assert(true)

#include <toml++/toml.h>
